//! The verdict at the head of a report: what flew, whether it kept its limits, and what went wrong, when, with which vehicle
//! and after which fault.

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::{Severity, Trace};
use skein_common::scenario::{self, Source};
use skein_common::state::Membership;

use super::page::{Line, Tone};
use crate::compare::folder::{Flown, Folder};
use crate::faults::InjectedFault;
use crate::metrics::limits::{self, Bound, Limit};
use crate::metrics::{AIRBORNE_ABOVE_M, COLLISION_M, CrashDetector, Measured, Run, figures};
use crate::recording::{Lacks, NotedKind, Recording, Track};
use crate::study::{self, rounded};

/// Most faults, and most reports of vehicles, that a verdict lists.
const MOST_LISTED: usize = 12;
/// Reports of several vehicles within this time are one, s.
const TOGETHER_S: f64 = 5.0;
/// The last fault before a collision or a crash is named as what preceded it if it is not older than this, s.
const PRECEDES_S: f64 = 120.0;
/// Largest time by which a flight may be shorter than its scenario, s: the last step is a little before the end.
const EARLY_S: f64 = 1.0;

/// A line that is neither good nor bad.
fn plain(text: impl Into<String>) -> Line {
    Line { tone: Tone::Plain, text: text.into() }
}

/// A line about whether something is as it should be.
fn judged(is_good: bool, text: impl Into<String>) -> Line {
    Line { tone: if is_good { Tone::Good } else { Tone::Bad }, text: text.into() }
}

/// The verdict on one flight; `measured` are its figures, if they are at hand.
pub fn of_flight(recording: &Recording, measured: Option<&Measured>) -> Vec<Line> {
    let Recording { scenario, run, .. } = recording;
    let duration_s = measured.and_then(|run| run.value("duration_s"));
    let duration_s = duration_s.or_else(|| last_s(recording));
    let mut lines = vec![plain(what_flew(run, duration_s))];
    lines.extend(missing(&recording.lacks, "The recording", last_s(recording), scenario.duration_s));
    let collisions = collisions(recording);
    let crashes = crashes(recording);
    match measured {
        Some(measured) => {
            lines.push(result(measured));
            lines.extend(kept_limits(scenario, measured));
        }
        None => {
            let nothing = collisions.is_empty() && crashes.is_empty();
            lines.push(match nothing {
                // Of a flight whose end is unknown, nothing good is known.
                true if recording.lacks.end => plain("Until then it shows no collision and no crash."),
                true => judged(true, "The recording shows no collision and no crash."),
                false => judged(false, "This flight failed."),
            });
        }
    }
    lines.extend(collisions);
    let seen = crashes.len();
    lines.extend(crashes);
    lines.extend(measured.and_then(|measured| unseen_crashes(recording, measured, seen)));
    lines.extend(injected(recording));
    lines.extend(reported(recording));
    lines
}

/// A sentence for each kind of thing that a recording lacks.
///
/// `file` names it at the beginning of a sentence; the last thing was recorded at `last_s`, and the flight was to be `asked_s`
/// long, s.
pub(super) fn missing(lacks: &Lacks, file: &str, last_s: Option<f64>, asked_s: Option<f64>) -> Vec<Line> {
    let mut lines = Vec::new();
    if lacks.end {
        let after =
            last_s.map_or_else(|| " before its first step".to_owned(), |last_s| format!(" after {last_s:.1} s"));
        let of = asked_s.map_or_else(String::new, |asked_s| format!(" of {asked_s:.0} s"));
        let text = format!("{file} is cut off{after}{of}, in the middle of the flight: what happened then is unknown.");
        lines.push(Line { tone: Tone::CutOff, text });
    }
    if lacks.pieces > 0 {
        let text = format!("{file} is damaged: {} of its pieces are left out.", lacks.pieces);
        lines.push(Line { tone: Tone::Missing, text });
    }
    if lacks.unrecorded > 0 {
        let text = format!("{file} lacks {} messages that the recorder could not write.", lacks.unrecorded);
        lines.push(Line { tone: Tone::Missing, text });
    }
    lines
}

/// The time of the last recorded step, s; `None` without a step.
fn last_s(recording: &Recording) -> Option<f64> {
    recording.tracks.iter().filter_map(|track| track.steps.last()).map(|step| step.t_s).reduce(f64::max)
}

fn for_s(duration_s: Option<f64>) -> String {
    duration_s.map_or_else(String::new, |duration_s| format!(" for {duration_s:.0} s"))
}

/// A sentence about what flew.
fn what_flew(run: &Run, duration_s: Option<f64>) -> String {
    let vehicles = if run.vehicles == 1 { "1 vehicle".to_owned() } else { format!("{} vehicles", run.vehicles) };
    let time = if run.target == "study" { "virtual time" } else { "real time" };
    let duration = for_s(duration_s);
    format!("{vehicles} flew the scenario {} with the law {}{duration} in {time}.", run.scenario, run.law)
}

/// Whether a flight did what every flight should.
fn result(run: &Measured) -> Line {
    let failure = |text: &str| text.strip_prefix("with ").unwrap_or(text).to_owned() + &study::detail(run, text);
    let failures: Vec<String> = study::failures(run).map(failure).collect();
    match failures.as_slice() {
        [] => judged(true, sentence(&study::achievements(&[run]).join(", "))),
        failures => judged(false, format!("This flight failed: {}.", failures.join("; "))),
    }
}

/// The text as a sentence.
fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| format!("{}{}.", first.to_uppercase(), letters.as_str()))
}

/// Whether the flight kept the limits of its scenario; `None` if it has none, or ended before its time.
fn kept_limits(scenario: &scenario::Scenario, run: &Measured) -> Option<Line> {
    let limits = limits::of(scenario)?;
    let duration_s = run.value("duration_s")?;
    if scenario.duration_s.is_some_and(|asked_s| duration_s < asked_s - EARLY_S) {
        return Some(plain(format!("It ended after {duration_s:.0} s: too soon for the limits of this formation.")));
    }
    let broken: Vec<String> =
        limits.iter().filter(|limit| !limit.is_kept(run)).map(|limit| beyond(limit, run)).collect();
    Some(match broken.as_slice() {
        [] => judged(true, format!("It kept all {} limits of this formation.", limits.len())),
        broken => {
            judged(false, format!("It broke {} of the {} limits: {}.", broken.len(), limits.len(), broken.join("; ")))
        }
    })
}

/// The text about a figure beyond its limit.
fn beyond(limit: &Limit, run: &Measured) -> String {
    let value = run.value(limit.key).map_or_else(|| "never".to_owned(), rounded);
    let (name, unit) = figures::of(limit.key).map_or((limit.key, ""), |figure| (figure.name, figure.unit));
    let (bound, limit) = match limit.bound {
        Bound::AtMost(limit) => ("at most", limit),
        Bound::AtLeast(limit) => ("at least", limit),
    };
    format!("{name}: {value}, allowed {bound} {limit} {unit}")
}

/// A line for each pair that collided, with the time of its nearest approach.
fn collisions(recording: &Recording) -> Vec<Line> {
    let tracks: Vec<&Track> = recording.tracks.iter().filter(|track| !track.steps.is_empty()).collect();
    let mut lines: Vec<(f64, Line)> = Vec::new();
    for (nth, one) in tracks.iter().enumerate() {
        for other in &tracks[..nth] {
            let Some((t_s, distance_m)) = nearest(one, other).filter(|(_, least_m)| *least_m < COLLISION_M) else {
                continue;
            };
            let after = preceding(recording, t_s, &[one.id, other.id]);
            let text =
                format!("Vehicles {} and {} collided: {distance_m:.1} m apart at {t_s:.0} s{after}.", other.id, one.id);
            lines.push((t_s, judged(false, text)));
        }
    }
    lines.sort_by(|one, other| one.0.total_cmp(&other.0));
    lines.into_iter().map(|(_, line)| line).collect()
}

/// The time at which two vehicles in the air were nearest to each other, s, and their distance then, m.
fn nearest(one: &Track, other: &Track) -> Option<(f64, f64)> {
    let apart_s = other.steps.windows(2).map(|pair| pair[1].t_s - pair[0].t_s).fold(f64::INFINITY, f64::min);
    let is_high = |trace: &Trace| trace.height_m > AIRBORNE_ABOVE_M;
    let at = |step: &crate::recording::Step| {
        let next = other.steps.partition_point(|their| their.t_s < step.t_s - apart_s / 2.0);
        let their = other.steps.get(next).filter(|their| (their.t_s - step.t_s).abs() <= apart_s)?;
        let both = is_high(&step.trace) && is_high(&their.trace);
        both.then(|| (step.t_s, (step.trace.position - their.trace.position).norm()))
    };
    one.steps.iter().filter_map(at).min_by(|one, other| one.1.total_cmp(&other.1))
}

/// A line for each vehicle that the recording shows to crash.
fn crashes(recording: &Recording) -> Vec<Line> {
    let mut lines: Vec<(f64, Line)> = Vec::new();
    for track in &recording.tracks {
        let mut detector = CrashDetector::default();
        let mut crashes = |trace: &Trace| {
            let lands = trace.membership != Membership::Active;
            detector.observe(trace.height_m, trace.velocity.0.norm(), &trace.attitude, lands)
        };
        let Some(step) = track.steps.iter().find(|step| crashes(&step.trace)) else { continue };
        let after = preceding(recording, step.t_s, &[track.id]);
        let text = format!("Vehicle {} crashed at {:.0} s{after}.", track.id, step.t_s);
        lines.push((step.t_s, judged(false, text)));
    }
    lines.sort_by(|one, other| one.0.total_cmp(&other.0));
    lines.into_iter().map(|(_, line)| line).collect()
}

/// A line about crashes that the figures count and the recording does not show: a vehicle without an agent is not recorded.
fn unseen_crashes(recording: &Recording, measured: &Measured, seen: usize) -> Option<Line> {
    let counted = measured.value("crashes")? as usize;
    if counted <= seen {
        return None;
    }
    let mut without = Vec::new();
    for noted in &recording.noted {
        match noted.what {
            NotedKind::Fault(InjectedFault::Died(id)) => without.push(id.to_string()),
            NotedKind::Fault(InjectedFault::Restarted(id)) => without.retain(|other| *other != id.to_string()),
            _ => {}
        }
    }
    let who = if without.is_empty() {
        String::new()
    } else {
        format!(" Without an agent at the end: vehicle {}.", without.join(", "))
    };
    let more = counted - seen;
    let crashes = if more == 1 { "1 crash is".to_owned() } else { format!("{more} crashes are") };
    Some(judged(false, format!("{crashes} not in the recording, which ends with a vehicle's agent.{who}")))
}

/// The last fault before this time that affected one of these vehicles, as ", 3 s after engine out of vehicle 5".
fn preceding(recording: &Recording, t_s: f64, vehicles: &[VehicleId]) -> String {
    let affects = |fault: &InjectedFault| match fault {
        InjectedFault::Died(id) | InjectedFault::Failed(id, _) => vehicles.contains(id),
        InjectedFault::Cut { links } | InjectedFault::Delayed { links } => {
            links.iter().any(|(sender, receiver)| vehicles.contains(sender) && vehicles.contains(receiver))
        }
        InjectedFault::Restarted(_) | InjectedFault::Healed { .. } | InjectedFault::DelayOver { .. } => false,
    };
    let mut faults = recording.noted.iter().filter_map(|noted| match &noted.what {
        NotedKind::Fault(fault) if noted.t_s <= t_s && affects(fault) => Some((noted.t_s, fault)),
        _ => None,
    });
    match faults.next_back() {
        Some((at_s, fault)) if t_s - at_s <= PRECEDES_S => {
            format!(", {:.0} s after {}", t_s - at_s, short(fault))
        }
        _ => String::new(),
    }
}

/// A fault in few letters, without the list of its links.
fn short(fault: &InjectedFault) -> String {
    match fault {
        InjectedFault::Cut { .. } => "the links between them were cut".to_owned(),
        InjectedFault::Delayed { .. } => "the links between them were delayed".to_owned(),
        InjectedFault::Failed(id, what) => format!("{} of vehicle {id}", what.replace('_', " ")),
        other => other.to_string(),
    }
}

/// A line with the faults that were injected, and the orders that were given.
fn injected(recording: &Recording) -> Option<Line> {
    let marks = super::flight::injected(recording);
    let texts = marks.iter().map(|(t_s, text)| format!("{text} at {t_s:.0} s"));
    listed("Injected faults and orders", texts.collect())
}

/// A line with what vehicles reported of failures and of losses.
fn reported(recording: &Recording) -> Option<Line> {
    let mut reports: Vec<(f64, VehicleSet, String)> = Vec::new();
    for noted in &recording.noted {
        let NotedKind::Event(id, what) = &noted.what else { continue };
        if what.severity() < Severity::Warning {
            continue;
        }
        let text = what.to_string();
        let known = reports.iter_mut().rev().find(|(t_s, _, other)| *other == text && noted.t_s - *t_s < TOGETHER_S);
        match known {
            Some((_, vehicles, _)) => vehicles.insert(*id),
            None => reports.push((noted.t_s, [*id].into_iter().collect(), text)),
        }
    }
    let texts = reports.iter().map(|(t_s, vehicles, text)| format!("{vehicles} at {t_s:.0} s: {text}"));
    listed("Reported by vehicles", texts.collect())
}

/// A line with the first of these texts and how many more there are; `None` without any.
fn listed(what: &str, mut texts: Vec<String>) -> Option<Line> {
    let more = texts.len().saturating_sub(MOST_LISTED);
    texts.truncate(MOST_LISTED);
    texts.extend((more > 0).then(|| format!("{more} more")));
    (!texts.is_empty()).then(|| plain(format!("{what}: {}.", texts.join("; "))))
}

/// The verdict on one run of which there is no recording.
pub(super) fn of_run(run: &Flown) -> Vec<Line> {
    let text = |key: &str| run.text(key).unwrap_or("–").to_owned();
    let duration_s = run.measured.value("duration_s");
    let vehicles = run.scenario.get("swarm.vehicles").and_then(|count| count.parse().ok()).unwrap_or(0);
    let flew = Run { scenario: text("scenario"), law: text("law"), target: text("target"), vehicles, ..Run::default() };
    let flew = match run.measured.value("teams") {
        Some(teams) => format!("{teams} teams flew the fleet {}{}.", flew.scenario, for_s(duration_s)),
        None => what_flew(&flew, duration_s),
    };
    let mut lines = vec![plain(flew), result(&run.measured)];
    lines.extend(scenario_of(run).and_then(|scenario| kept_limits(&scenario, &run.measured)));
    lines
}

/// The scenario of a run, if this program can read it.
fn scenario_of(run: &Flown) -> Option<scenario::Scenario> {
    let path = run.folder.join("scenario.toml");
    let text = std::fs::read_to_string(&path).ok()?;
    let name = path.display().to_string();
    scenario::load(&Source { name: &name, text: &text }, &[]).ok().map(|loaded| loaded.scenario)
}

/// The verdict on a study, or on any other folder of several runs.
pub(super) fn of_study(folder: &Folder) -> Vec<Line> {
    let runs = &folder.runs;
    let (good, failed): (Vec<&Flown>, Vec<&Flown>) =
        runs.iter().partition(|run| study::failures(&run.measured).next().is_none());
    let good_runs: Vec<&Measured> = good.iter().map(|run| &run.measured).collect();
    let scenarios = folder.texts("scenario").into_iter().collect::<Vec<_>>().join(", ");
    let mut lines = vec![plain(format!("{} runs of {scenarios}.", runs.len()))];
    if !good.is_empty() {
        let achievements = study::achievements(&good_runs).join(", ");
        let text = format!("{} of {} runs: {achievements}.", good.len(), runs.len());
        lines.push(judged(failed.is_empty(), text));
    }
    // The kinds of failures, in the order in which they first occur.
    let texts = failed.iter().flat_map(|run| study::failures(&run.measured));
    let mut kinds: Vec<&str> = Vec::new();
    texts.for_each(|text| {
        if !kinds.contains(&text) {
            kinds.push(text)
        }
    });
    for kind in kinds {
        let are: Vec<&&Flown> =
            failed.iter().filter(|run| study::failures(&run.measured).any(|text| text == kind)).collect();
        let places: Vec<String> = are.iter().map(|run| place(folder, run)).collect();
        let replay = are.first().map(|run| run.replay()).unwrap_or_default();
        let text =
            format!("{} of {} runs {kind}: {}. To fly it again: {replay}", are.len(), runs.len(), study::list(&places));
        lines.push(judged(false, text));
    }
    let judged_runs: Vec<(&Flown, Line)> = runs
        .iter()
        .filter_map(|run| Some((run, kept_limits(&scenario_of(run)?, &run.measured)?)))
        .filter(|(_, line)| line.tone != Tone::Plain)
        .collect();
    let broken: Vec<&(&Flown, Line)> = judged_runs.iter().filter(|(_, line)| line.tone == Tone::Bad).collect();
    match (judged_runs.len(), broken.as_slice()) {
        (0, _) => {}
        (all, []) => lines.push(judged(true, format!("All limits of this formation are kept in {all} of {all} runs."))),
        (all, [first, ..]) => {
            let text = format!(
                "{} of {all} runs break limits of this formation. {}: {}",
                broken.len(),
                place(folder, first.0),
                first.1.text
            );
            lines.push(judged(false, text));
        }
    }
    lines
}

/// The place of a run in its folder, as text.
fn place(folder: &Folder, run: &Flown) -> String {
    if folder.swept.is_empty() {
        return format!("seed {}", run.measured.seed);
    }
    let inside = run.folder.strip_prefix(&folder.path).unwrap_or(&run.folder);
    let point =
        inside.parent().and_then(|point| point.file_name()).map(|point| point.to_string_lossy().replace('-', " "));
    format!("{} seed {}", point.unwrap_or_default(), run.measured.seed).trim_start().to_owned()
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, BTreeSet};
    use std::sync::LazyLock;

    use proptest::prelude::*;
    use skein_common::frame::{Attitude, PositionNed, VelocityNed};

    use super::*;
    use crate::record::tests::steps;
    use crate::recording::{Noted, Watch};
    use crate::shipped;
    use crate::study::any_run;

    /// A step of a vehicle that has flown.
    static STEP: LazyLock<Trace> = LazyLock::new(|| steps().swap_remove(0));
    const HIGH_M: f64 = 30.0;

    /// Any flight of three vehicles on a line, of which agents end: each second each vehicle is high or on the ground.
    fn any_flight() -> impl Strategy<Value = Recording> {
        let place =
            (prop_oneof![1 => Just(0.2), 3 => Just(HIGH_M)], (0_u8..24).prop_map(|halves| f64::from(halves) / 2.0));
        let seconds = prop::collection::vec(prop::array::uniform3(place), 0..6);
        let deaths = prop::collection::btree_map(0_u8..6, 1_u8..=3, 0..3);
        let lacks = (any::<bool>(), 0_usize..3, 0_u64..3);
        (seconds, deaths, lacks).prop_map(|(seconds, deaths, (end, pieces, unrecorded))| {
            let scenario = Source { name: "line", text: "swarm.vehicles = 3" };
            let scenario = scenario::load(&scenario, &[]).unwrap().scenario;
            let lacks = Lacks { end, pieces, unrecorded };
            let mut recording = Recording { lacks, ..Recording::new(&scenario, Run::new(&scenario, "study")) };
            for (t_s, second) in (0_u8..).map(f64::from).zip(seconds) {
                for (id, (height_m, north_m)) in scenario.ids().zip(second) {
                    let mut step = Trace { height_m, membership: Membership::Active, ..STEP.clone() };
                    step.header.sender = id;
                    step.position = PositionNed::new(north_m, 0.0, -height_m);
                    (step.velocity, step.attitude) = (VelocityNed::default(), Attitude::default());
                    recording.step(t_s, &step);
                }
            }
            for (t_s, id) in deaths {
                recording.fault(f64::from(t_s), &InjectedFault::Died(VehicleId::new(id).unwrap()));
            }
            recording
        })
    }

    /// The pairs that come too near to each other in the air.
    fn collided(recording: &Recording) -> Vec<[VehicleId; 2]> {
        let pairs = [(0, 1), (0, 2), (1, 2)].map(|(one, other)| [&recording.tracks[one], &recording.tracks[other]]);
        let meet = |[one, other]: &[&Track; 2]| {
            let mut seconds = one.steps.iter().map(|step| &step.trace).zip(other.steps.iter().map(|step| &step.trace));
            seconds.any(|(one, other)| {
                let is_high = one.height_m == HIGH_M && other.height_m == HIGH_M;
                is_high && (one.position.north_m() - other.position.north_m()).abs() < COLLISION_M
            })
        };
        pairs.into_iter().filter(meet).map(|pair| pair.map(|track| track.id)).collect()
    }

    /// The vehicles that descend although none was to land, and when, s.
    fn crashed(recording: &Recording) -> Vec<(VehicleId, f64)> {
        let down = |track: &Track| {
            let heights = track.steps.windows(2).find(|pair| pair[0].trace.height_m > pair[1].trace.height_m)?;
            Some((track.id, heights[1].t_s))
        };
        recording.tracks.iter().filter_map(down).collect()
    }

    fn count(lines: &[Line], tone: Tone) -> usize {
        lines.iter().filter(|line| line.tone == tone).count()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn a_recording_is_judged_by_what_it_shows(recording in any_flight()) {
            let (collided, crashed) = (collided(&recording), crashed(&recording));
            let lines = of_flight(&recording, None);
            let (shown, lacks) = (collided.len() + crashed.len(), recording.lacks);
            prop_assert_eq!(count(&lines, Tone::Bad), if shown == 0 { 0 } else { shown + 1 });
            prop_assert_eq!(count(&lines, Tone::Good), usize::from(shown == 0 && !lacks.end));
            prop_assert_eq!(count(&lines, Tone::CutOff), usize::from(lacks.end));
            let missing = usize::from(lacks.pieces > 0) + usize::from(lacks.unrecorded > 0);
            prop_assert_eq!(count(&lines, Tone::Missing), missing);
            for [one, other] in collided {
                let text = format!("Vehicles {one} and {other} collided: ");
                prop_assert!(lines.iter().any(|line| line.text.starts_with(&text)), "{}", text);
            }
            for (id, t_s) in crashed {
                let text = format!("Vehicle {id} crashed at {t_s:.0} s");
                let line = lines.iter().find(|line| line.text.starts_with(&text));
                let line = line.ok_or_else(|| TestCaseError::fail(text))?;
                let died = |noted: &Noted| noted.what == NotedKind::Fault(InjectedFault::Died(id)) && noted.t_s <= t_s;
                prop_assert_eq!(line.text.contains(" s after "), recording.noted.iter().any(died), "{}", line.text);
            }
        }

        #[test]
        fn a_flight_with_figures_fails_by_them_and_by_what_its_recording_shows(recording in any_flight(), run in any_run()) {
            let lines = of_flight(&recording, Some(&run));
            let failures: Vec<&str> = study::failures(&run).collect();
            let crashed = crashed(&recording).len();
            let has_unseen = run.value("crashes").is_some_and(|crashes| crashes as usize > crashed);
            let bad = usize::from(!failures.is_empty()) + collided(&recording).len() + crashed + usize::from(has_unseen);
            prop_assert_eq!(count(&lines, Tone::Bad), bad);
            prop_assert_eq!(count(&lines, Tone::Good), usize::from(failures.is_empty()));
            let result = result(&run).text;
            prop_assert!(failures.iter().all(|failure| result.contains(failure.trim_start_matches("with "))), "{}", result);
        }

        #[test]
        fn a_broken_limit_is_named(mut broken in prop::collection::btree_set(0..limits::HOVER.len(), 0..4), is_short: bool) {
            let hover = scenario::load(&shipped::HOVER, &[]).unwrap().scenario;
            let is_mean = |nth: &usize| limits::HOVER[*nth].key == "radial_mean_m";
            // The mean radius has two limits, of which it breaks one at most.
            if let [_, above] = broken.iter().copied().filter(is_mean).collect::<Vec<_>>()[..] {
                broken.remove(&above);
            }
            let flown_s = hover.duration_s.unwrap() - if is_short { 2.0 * EARLY_S } else { 0.0 };
            let mut run = Measured { figures: BTreeMap::from([("duration_s".to_owned(), Some(flown_s))]), ..Measured::default() };
            let mut put = |limit: &Limit, by: f64| {
                let value = match limit.bound { Bound::AtMost(most) => most + by, Bound::AtLeast(least) => least - by };
                run.figures.insert(limit.key.to_owned(), Some(value));
            };
            limits::HOVER.iter().for_each(|limit| put(limit, 0.0));
            broken.iter().for_each(|nth| put(&limits::HOVER[*nth], 0.5));
            let line = kept_limits(&hover, &run).unwrap();
            let tone = if is_short { Tone::Plain } else if broken.is_empty() { Tone::Good } else { Tone::Bad };
            prop_assert_eq!(line.tone, tone, "{}", line.text);
            let named = limits::HOVER.iter().enumerate().filter(|(_, limit)| line.text.contains(&beyond(limit, &run)));
            let named: BTreeSet<usize> = named.map(|(nth, _)| nth).collect();
            prop_assert_eq!(named, if is_short { BTreeSet::new() } else { broken });
        }

        #[test]
        fn a_study_is_good_if_all_its_runs_are(runs in prop::collection::vec(any_run(), 1..8)) {
            let flown = |measured: &Measured| Flown {
                folder: format!("no-study/seed-{}", measured.seed).into(),
                measured: measured.clone(),
                scenario: BTreeMap::new(),
            };
            let runs: Vec<Flown> = runs.iter().map(flown).collect();
            let failed = |run: &&Flown| study::failures(&run.measured).next().is_some();
            let failures: BTreeSet<&str> = runs.iter().flat_map(|run| study::failures(&run.measured)).collect();
            let failed = runs.iter().filter(failed).count();
            let folder = Folder { path: "no-study".into(), runs: runs.clone(), is_unfinished: false, swept: Vec::new() };
            let lines = of_study(&folder);
            prop_assert_eq!(count(&lines, Tone::Good), usize::from(failed == 0));
            prop_assert_eq!(count(&lines, Tone::Bad), failures.len() + usize::from(failed > 0 && failed < runs.len()));
            for failure in failures {
                let are = runs.iter().filter(|run| study::failures(&run.measured).any(|text| text == failure)).count();
                let text = format!("{are} of {} runs {failure}: ", runs.len());
                prop_assert!(lines.iter().any(|line| line.tone == Tone::Bad && line.text.starts_with(&text)), "{}", text);
            }
        }
    }
}
