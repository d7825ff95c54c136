//! Whether a swarm fits onto this PC: what its agents will ask of the processor, from what a message and a step cost here.

use std::io::{self, BufRead, IsTerminal, Write};

use super::measure::{self, StepTime};
use super::words::{self, FRAME_HZ};
use crate::error::Error;
use crate::os;

/// Smaller swarms fit onto any PC: so many vehicles a core are not measured.
const UNMEASURED_A_CORE: usize = 4;
/// How long sessions are silent, and how long they talk, s.
const TALK_S: f64 = 0.6;
/// Each flight's length in virtual time, s.
const FLIGHT_S: f64 = 40.0;

/// What an agent costs here, measured.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Costs {
    /// A message from one agent's hands into another's, both ends together, µs of processor.
    message_us: f64,
    /// How often a vehicle sends its state, Hz.
    states_hz: f64,
    /// How often it sends its register, Hz.
    register_hz: f64,
    /// Its steps, flight model included.
    step: StepTime,
}

impl Costs {
    /// Measures for some two seconds; `None` where the system does not tell processor time.
    ///
    /// # Errors
    /// If sessions cannot be opened, or nothing comes through.
    fn measure() -> Result<Option<Self>, Error> {
        let failed = |why: String| Error::Failed(format!("what this PC carries: {why}"));
        let time = words::time(TALK_S).map_err(failed)?;
        let (talk, step) = measure::flights(FLIGHT_S).map_err(failed)?;
        let states_hz = talk.iter().map(|talk| talk.states_hz).fold(0.0, f64::max);
        let known = time.word_us.zip(step);
        Ok(known.map(|(message_us, step)| Self { message_us, states_hz, register_hz: measure::REGISTER_HZ, step }))
    }

    /// Cores that so many agents ask for, all on one PC, with `skein fly` that listens to every step.
    fn cores(&self, vehicles: usize) -> f64 {
        let (count, others) = (vehicles as f64, vehicles as f64 - 1.0);
        let messages = count * others * (self.states_hz + self.register_hz) + count * FRAME_HZ;
        let steps_us = count * FRAME_HZ * (self.step.alone_us + self.step.per_peer_us * others);
        (messages * self.message_us + steps_us) * 1e-6
    }

    /// The largest swarm that asks for no more than this.
    fn most(&self, cores: f64) -> usize {
        (1..=usize::from(u8::MAX)).take_while(|vehicles| self.cores(*vehicles) <= cores).last().unwrap_or(0)
    }
}

/// Measures whether so many agents fit onto this PC. If they do not, asks whoever sits at the terminal; without one, refuses.
///
/// # Errors
/// If they do not fit and nobody wants it all the same, or if it cannot be measured.
pub fn ask_for(vehicles: usize, anyway: bool) -> Result<(), Error> {
    let cores = os::cores();
    if anyway || vehicles <= UNMEASURED_A_CORE * cores {
        return Ok(());
    }
    eprintln!("measuring what this PC carries");
    let Some(costs) = Costs::measure()? else { return Ok(()) };
    judge(&costs, vehicles, cores, question)
}

fn judge(costs: &Costs, vehicles: usize, cores: usize, ask: impl FnOnce(&str) -> bool) -> Result<(), Error> {
    let (needed, most) = (costs.cores(vehicles), costs.most(cores as f64));
    if needed <= cores as f64 {
        return Ok(());
    }
    let finding = format!(
        "{vehicles} agents ask for {needed:.1} cores and this PC has {cores}: it carries {most} (measured just now: {:.0} us of \
         processor for a message, {:.0} messages a second of each agent to each other)",
        costs.message_us,
        costs.states_hz + costs.register_hz
    );
    if ask(&finding) {
        return Ok(());
    }
    Err(Error::Refused(format!(
        "{finding}; fly at most {most} here (--set swarm.vehicles={most}), the whole swarm in virtual time (`skein study`) or on \
         several PCs (`skein cluster`), or --anyway"
    )))
}

/// Asks whoever sits at the terminal.
fn question(finding: &str) -> bool {
    if !io::stdin().is_terminal() || !io::stderr().is_terminal() {
        return false;
    }
    eprint!("{finding}. Fly all the same? [y/N] ");
    let _ = io::stderr().flush();
    let mut answer = String::new();
    io::stdin().lock().read_line(&mut answer).is_ok() && matches!(answer.trim(), "y" | "Y" | "yes")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What was measured on a PC with two cores.
    const COSTS: Costs = Costs {
        message_us: 100.0,
        states_hz: 5.0,
        register_hz: 5.0,
        step: StepTime { alone_us: 10.0, per_peer_us: 0.0 },
    };

    #[test]
    fn the_cost_grows_with_the_pairs() {
        // 64 × 63 × 10 messages and 64 × 50 traces of 100 us, 64 × 50 steps of 10 us.
        assert!((COSTS.cores(64) - (4.032 + 0.32 + 0.032)).abs() < 1e-9);
        let most = COSTS.most(2.0);
        assert!(COSTS.cores(most) <= 2.0 && COSTS.cores(most + 1) > 2.0, "{most}");
        assert_eq!(COSTS.most(0.0), 0);
    }

    #[test]
    fn a_swarm_that_does_not_fit_is_refused_with_a_figure_unless_its_user_wants_it() {
        assert!(judge(&COSTS, 32, 2, |_| panic!("asked")).is_ok());
        assert!(judge(&COSTS, 64, 2, |_| true).is_ok());
        let refused = judge(&COSTS, 64, 2, |_| false).unwrap_err();
        assert_eq!(refused.exit_code(), 2);
        let most = COSTS.most(2.0);
        let said = refused.to_string();
        assert!(
            said.starts_with(&format!("64 agents ask for 4.4 cores and this PC has 2: it carries {most} (")),
            "{said}"
        );
        assert!(said.contains(&format!("--set swarm.vehicles={most}")) && said.ends_with("--anyway"), "{said}");
    }

    #[test]
    fn what_an_agent_costs_is_measured() {
        let Some(costs) = Costs::measure().unwrap() else { return };
        assert!((0.0..20_000.0).contains(&costs.message_us), "{costs:?}");
        assert!(costs.states_hz >= 4.0 && costs.step.alone_us > 0.1, "{costs:?}");
        assert!(ask_for(1, false).is_ok());
    }
}
