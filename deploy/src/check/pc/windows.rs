//! Checks of what only Windows has: its firewall, its time service, its power plan and its timer, each with Windows' own remedy.
//!
//! Windows translates what its programs print, but not the registry's values, numbers and identifiers: only those are read.

use std::path::Path;
use std::time::Duration;

use skein_host::clock;

use super::{line, printed};
use skein_cluster::findings::Line;

/// The key under which the firewall keeps its profiles and rules.
const FIREWALL: &str = r"HKLM\SYSTEM\CurrentControlSet\Services\SharedAccess\Parameters\FirewallPolicy";
/// Identifier of the power plan that saves energy.
const POWER_SAVER: &str = "a1841308-3541-4fab-bc81-f71556f20b4a";
/// With sleeps longer than this a control loop of 50 frames a second is irregular.
const COARSE_TIMER: Duration = Duration::from_millis(5);

/// All lines that are not about ports.
pub(super) fn lines() -> Vec<Line> {
    vec![
        clock_of(printed("w32tm", &["/query", "/status"]).as_deref()),
        power(printed("powercfg", &["/getactivescheme"]).as_deref()),
        sleep(printed("powercfg", &["/query", "SCHEME_CURRENT", "SUB_SLEEP", "STANDBYIDLE"]).as_deref()),
        timer(longest_sleep()),
    ]
}

/// Whether the time service keeps the clock synchronised, according to its status: its first line ends in the leap indicator.
fn clock_of(status: Option<&str>) -> Line {
    let indicator = status.and_then(|text| text.lines().next()?.split_once(':')?.1.trim().chars().next());
    match indicator {
        Some('0'..='2') => line("clock", "synchronised"),
        Some('3') => line("clock", "not synchronised; no flight depends on it, recordings of several PCs do")
            .warning("`w32tm /resync`, as administrator; `w32tm /config /manualpeerlist:HOST /syncfromflags:manual /update` names a server"),
        _ => line("clock", "the time service does not run; no flight depends on it, recordings of several PCs do")
            .warning("`sc config w32time start= auto`, and then `net start w32time`, as administrator"),
    }
}

fn power(scheme: Option<&str>) -> Line {
    match scheme.map(str::to_ascii_lowercase) {
        Some(text) if text.contains(POWER_SAVER) => line("power plan", "it saves energy: steps may be late")
            .warning("`powercfg /setactive SCHEME_MIN` selects the plan for high performance"),
        Some(text) if text.contains('-') => line("power plan", "it does not slow agents"),
        _ => line("power plan", "no answer of powercfg").unknown(),
    }
}

/// After which time without a key this PC sleeps, according to the setting's table: the last two numbers are seconds, on mains and
/// on battery.
fn sleep(setting: Option<&str>) -> Line {
    let number = |line: &str| u32::from_str_radix(line.rsplit_once("0x")?.1.trim(), 16).ok();
    let numbers: Vec<u32> = setting.into_iter().flat_map(str::lines).filter_map(number).collect();
    match numbers.as_slice() {
        [.., 0, _] => line("sleep", "never on mains"),
        [.., on_mains_s, _] => {
            line("sleep", format!("after {} min without a key, also in flight", on_mains_s.div_ceil(60)))
                .warning("`powercfg /change standby-timeout-ac 0`")
        }
        _ => line("sleep", "no answer of powercfg").unknown(),
    }
}

/// The longest of several sleeps of a millisecond.
fn longest_sleep() -> Duration {
    let slept = |_| {
        let begin = clock::now();
        clock::sleep(Duration::from_millis(1));
        clock::now() - begin
    };
    (0..20).map(slept).max().unwrap_or_default()
}

fn timer(longest: Duration) -> Line {
    let found = format!("sleeps of 1 ms take up to {:.1} ms", longest.as_secs_f64() * 1e3);
    match longest > COARSE_TIMER {
        true => line("timer", found).warning(
            "Windows 10 version 1803 and newer have a fine timer: install it, or end other programs if this PC is busy",
        ),
        false => line("timer", found),
    }
}

/// Whether the firewall lets other PCs reach this program.
pub(super) fn firewall(program: &Path) -> Line {
    let query = |what: &str| printed("reg", &["query", &format!(r"{FIREWALL}\{what}")]);
    let profiles = ["DomainProfile", "StandardProfile", "PublicProfile"].map(query);
    firewall_of(&profiles, query("FirewallRules").as_deref(), program)
}

fn firewall_of(profiles: &[Option<String>], rules: Option<&str>, program: &Path) -> Line {
    // A value's line: its name, its type, its value.
    let is_on = |text: &String| {
        let value = text.lines().find_map(|line| line.trim().strip_prefix("EnableFirewall")?.split_whitespace().last());
        value == Some("0x1")
    };
    if profiles.iter().all(Option::is_none) {
        return line("firewall", "its settings cannot be read").unknown();
    }
    if !profiles.iter().flatten().any(is_on) {
        return line("firewall", "off");
    }
    let program = program.display().to_string().to_ascii_lowercase();
    let lets_in = |rule: &str| {
        let rule = rule.to_ascii_lowercase();
        let parts = ["|action=allow|", "|active=true|", "|dir=in|"];
        parts.iter().all(|part| rule.contains(part)) && rule.contains(&format!("|app={program}|"))
    };
    match rules.into_iter().flat_map(str::lines).any(lets_in) {
        true => line("firewall", "on, with a rule that lets other PCs reach this program"),
        false => line("firewall", "on, without a rule for this program; a flight on this PC alone is not affected").warning(format!(
            "for a cluster or an X-Plane on another PC, as administrator: `netsh advfirewall firewall add rule name=Skein dir=in \
             action=allow program=\"{program}\"`, and the same with dir=out where outgoing packets are blocked"
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use skein_cluster::findings::State;

    #[test]
    fn the_time_service_is_read_in_every_language() {
        let states = [
            Some("Leap Indicator: 0(no warning)\r\nStratum: 4 (secondary reference)\r\n"),
            Some("Sprungindikator: 3(nicht synchronisiert)\r\nStratum: 0 (nicht angegeben)\r\n"),
            None,
        ]
        .map(|status| clock_of(status).state);
        assert_eq!(states, [State::Good, State::Warning, State::Warning]);
    }

    #[test]
    fn a_plan_that_saves_energy_and_a_pc_that_sleeps_are_warnings() {
        let plan = |guid: &str| power(Some(&format!("GUID des Energieschemas: {guid}  (Plan)\r\n"))).state;
        assert_eq!(plan("381b4222-f694-41f0-9685-ff5bb260df2e"), State::Good);
        assert_eq!(plan(&POWER_SAVER.to_uppercase()), State::Warning);
        assert_eq!(power(None).state, State::Unknown);
        let table = |mains: &str| {
            format!(
                "  Minimum: 0x00000000\r\n  Maximum: 0xffffffff\r\n  Index (AC): {mains}\r\n  Index (DC): 0x00000384\r\n\r\n"
            )
        };
        assert_eq!(sleep(Some(&table("0x00000000"))).state, State::Good);
        let sleeps = sleep(Some(&table("0x00000708")));
        assert!(sleeps.state == State::Warning && sleeps.found.starts_with("after 30 min"), "{sleeps:?}");
        assert_eq!(sleep(Some("")).state, State::Unknown);
    }

    #[test]
    fn a_coarse_timer_is_a_warning() {
        assert_eq!(timer(Duration::from_micros(1_600)).state, State::Good);
        assert_eq!(timer(Duration::from_micros(15_600)).state, State::Warning);
    }

    #[test]
    fn a_firewall_that_is_on_needs_a_rule_for_this_program() {
        let profile = |value: &str| {
            Some(format!(
                "\r\nHKEY_LOCAL_MACHINE\\...\\PublicProfile\r\n    EnableFirewall    REG_DWORD    {value}\r\n"
            ))
        };
        let program = Path::new(r"C:\Users\lab\Skein\skein.exe");
        let rule = |action: &str, app: &str| {
            format!(
                "    {{1}}    REG_SZ    v2.30|Action={action}|Active=TRUE|Dir=In|Protocol=6|App={app}|Name=Skein|\r\n"
            )
        };
        let state = |profiles: [Option<String>; 2], rules: &str| firewall_of(&profiles, Some(rules), program).state;
        assert_eq!(firewall_of(&[None, None], None, program).state, State::Unknown);
        assert_eq!(state([profile("0x0"), None], ""), State::Good);
        assert_eq!(state([profile("0x0"), profile("0x1")], ""), State::Warning);
        assert_eq!(state([profile("0x1"), None], &rule("Allow", r"c:\users\LAB\Skein\skein.exe")), State::Good);
        for rules in [rule("Block", r"C:\Users\lab\Skein\skein.exe"), rule("Allow", r"C:\other\skein.exe")] {
            assert_eq!(state([profile("0x1"), None], &rules), State::Warning, "{rules}");
        }
    }
}
