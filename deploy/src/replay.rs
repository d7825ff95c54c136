//! `skein replay`: runs the core of an agent again with its recorded inputs, and compares what it gives with what it gave in
//! flight.

use std::fmt::Write;
use std::fs;
use std::panic::{self, AssertUnwindSafe};
use std::path::PathBuf;
use std::str::FromStr;

use serde::Serialize;
use serde_json::{Value, json};
use skein_agent::inputs::{Flown, InputsError, InputsReader, RecordedStep};
use skein_common::message::{EventKind, Trace};
use skein_core::agent::Outputs;
use skein_core::formation::Workspace;
use skein_core::plant::GroundTruth;
use skein_core::station::Station;
use skein_lab::error::Error;
use skein_lab::terminal::{complain, json as indented, say};

/// `skein replay`
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  skein replay skein-runs/hover/agents/3-1763999000000000000.inputs\n  skein replay FILE --break-at 31.3\n  skein replay FILE --break-at failed --json"
)]
pub struct ReplayArgs {
    /// File of an agent's inputs, which it leaves beside its log after a fault, and always under record.inputs = true
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// End after this time since the agent's start, s
    #[arg(long, value_name = "S")]
    pub until: Option<f64>,
    /// Print the agent's state at this time, s, or at the first event whose text or name contains this, and end there
    #[arg(long, value_name = "S|EVENT")]
    pub break_at: Option<Break>,
    /// Print a JSON object
    #[arg(long)]
    pub json: bool,
}

/// The step at which a replay stops.
#[derive(Clone, Debug, PartialEq)]
pub enum Break {
    /// At the first step at this time or later, s.
    At(f64),
    /// At the first event whose text or name contains this, in any case.
    Event(String),
}

impl FromStr for Break {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse() {
            Ok(at_s) if f64::is_finite(at_s) => Ok(Self::At(at_s)),
            Ok(_) => Err("a time is a finite number of seconds".to_owned()),
            Err(_) if text.is_empty() => Err("give a time in seconds, or part of an event".to_owned()),
            Err(_) => Ok(Self::Event(text.to_lowercase())),
        }
    }
}

impl Break {
    fn is_here(&self, at_s: f64, events: &[EventKind]) -> bool {
        match self {
            Self::At(break_s) => at_s >= *break_s,
            Self::Event(part) => events.iter().any(|event| format!("{event} {event:?}").to_lowercase().contains(part)),
        }
    }
}

/// The first step in which the core gave something else than in flight.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Difference {
    step: u64,
    at_s: f64,
    #[serde(rename = "in_flight")]
    recorded: Option<Outputs>,
    /// `None` if the core panicked.
    replayed: Option<Outputs>,
}

/// The findings of a replay.
#[derive(Debug, Default)]
struct Replayed {
    /// Number of steps that were run.
    steps: u64,
    /// Time of the last of them since the agent's start, s.
    end_s: f64,
    /// The events that the core reported, with the time, s.
    events: Vec<(f64, EventKind)>,
    difference: Option<Difference>,
    /// The state after the step of the breakpoint.
    state: Option<Trace>,
    /// Whether the core panicked in the last step, as in flight.
    has_panicked: bool,
    /// Whether the file ends within a step, as after a process was killed.
    is_cut_off: bool,
    /// The damage of the file, with its place; `None` if the file is intact.
    damage: Option<InputsError>,
}

/// Replays the file and prints what it finds.
///
/// # Errors
/// The file cannot be used, the outputs differ, or the breakpoint is not met.
pub fn run(args: &ReplayArgs) -> Result<(), Error> {
    let name = args.file.display();
    let refused = |error: &dyn std::error::Error| Error::Refused(format!("{name}: {error}"));
    let bytes = fs::read(&args.file).map_err(|error| refused(&error))?;
    let reader = InputsReader::new(&bytes).map_err(|error| refused(&error))?;
    let flown = reader.flown.clone();
    let station = flown.station().map_err(|error| refused(&error))?;
    let replayed = replay(reader, station, args);
    say(&if args.json { indented(&as_json(&flown, &replayed)) } else { as_text(&flown, &replayed) });
    if let Some(damage) = &replayed.damage {
        return Err(refused(damage));
    }
    if let Some(difference) = &replayed.difference {
        let at_s = difference.at_s;
        return Err(Error::Failed(format!("{name}: the outputs differ from {at_s:.3} s on, step {}", difference.step)));
    }
    match (&args.break_at, &replayed.state) {
        (Some(Break::At(at_s)), None) => Err(Error::Failed(format!(
            "{name}: no step at {at_s} s or later; the last one is at {:.3} s",
            replayed.end_s
        ))),
        (Some(Break::Event(part)), None) => Err(Error::Failed(format!("{name}: no event with \"{part}\""))),
        _ => Ok(()),
    }
}

fn replay(mut reader: InputsReader<'_>, mut station: Station, args: &ReplayArgs) -> Replayed {
    let mut workspace = Workspace::default();
    let mut replayed = Replayed::default();
    loop {
        let step = match reader.next_step() {
            Ok(Some(step)) => step,
            Ok(None) => break,
            Err(error) => {
                replayed.damage = Some(error);
                break;
            }
        };
        let (right, plant_time, at_s) = (step.inputs.right, step.inputs.plant_time, step.inputs.right.seconds());
        if args.until.is_some_and(|until_s| at_s > until_s) {
            break;
        }
        (replayed.steps, replayed.end_s) = (replayed.steps + 1, at_s);
        let Some(outputs) = run_step(&mut station, &step, &mut workspace) else {
            replayed.has_panicked = step.outputs.is_none();
            let difference =
                |recorded| Difference { step: replayed.steps, at_s, recorded: Some(recorded), replayed: None };
            replayed.difference = step.outputs.map(difference);
            break;
        };
        replayed.events.extend(outputs.outbox.happened.iter().map(|event| (at_s, *event)));
        let is_here = |place: &Break| place.is_here(at_s, &outputs.outbox.happened);
        if args.break_at.as_ref().is_some_and(is_here) {
            // The file has the inputs of the core. The plant's true state is not one of them, so the trace has none.
            replayed.state = Some(station.trace(right, plant_time, &GroundTruth::default()));
        }
        if !step.has_outputs(&outputs) {
            replayed.difference =
                Some(Difference { step: replayed.steps, at_s, recorded: step.outputs, replayed: Some(outputs) });
            break;
        }
        if replayed.state.is_some() {
            break;
        }
    }
    replayed.is_cut_off = reader.is_cut_off;
    replayed
}

/// Runs the core for this step and returns its outputs; `None` if it panics.
fn run_step(station: &mut Station, step: &RecordedStep, workspace: &mut Workspace) -> Option<Outputs> {
    let mut inputs = step.inputs.clone();
    // After a panic the station is not used again.
    let run = AssertUnwindSafe(|| station.step_with(&mut inputs, workspace));
    panic::catch_unwind(run).inspect_err(|_| complain("the core panics in the last step")).ok()
}

fn as_text(flown: &Flown, replayed: &Replayed) -> String {
    let Replayed { steps, end_s, events, difference, state, .. } = replayed;
    let mut text = format!(
        "vehicle {}, incarnation {}, release {}: {steps} steps, {end_s:.2} s since the agent's start\n",
        flown.vehicle, flown.incarnation.0, flown.release
    );
    for (at_s, event) in events {
        let _ = writeln!(text, "{at_s:>9.2} s  {event}");
    }
    if let Some(state) = state {
        text += &state_text(*end_s, *steps, state);
    }
    text += &match difference {
        Some(difference) => difference_text(flown, difference),
        None if replayed.has_panicked => "the core panics in the last step, as in flight\n".to_owned(),
        None => "all outputs are the same as in flight, byte for byte\n".to_owned(),
    };
    if replayed.is_cut_off {
        text += "the file was cut off here: the agent was killed, or its disk was full\n";
    }
    text
}

fn state_text(at_s: f64, step: u64, state: &Trace) -> String {
    let numbers = |numbers: &[f64]| numbers.iter().map(|number| format!("{number:.3}")).collect::<Vec<_>>().join(", ");
    let estimate = [state.estimate.north_m(), state.estimate.east_m(), state.estimate.altitude_m()];
    let mut text = format!("at {at_s:.3} s, after step {step}:\n");
    let mut line = |name: &str, value: String| {
        let _ = writeln!(text, "  {name:<10} {value}");
    };
    line("activity", format!("{}, {:?}", state.activity, state.membership));
    let reached = state.reached.map_or_else(|| "none".to_owned(), |step| step.to_string());
    line(
        "mission",
        format!("step {}, reached {reached}, centre {} m north and east", state.step, numbers(&state.centre_ne_m)),
    );
    line("estimate", format!("{} m north, east, up", numbers(&estimate)));
    line("field", format!("{} north, east", numbers(&state.field_ne)));
    line(
        "setpoint",
        format!(
            "{} m north and east of the estimate, {:.3} m up",
            numbers(&state.error_ne_m),
            state.altitude_setpoint_m
        ),
    );
    let controls = state.controls.map_or_else(|| "none".to_owned(), |controls| numbers(&controls));
    line("controls", format!("{controls} roll, pitch, yaw, collective"));
    for peer in &state.peers {
        let delay = peer.delay_s.map_or_else(String::new, |delay_s| format!(", delay below {delay_s:.3} s"));
        line(&format!("peer {}", peer.id), format!("{:?}, state {:.3} s old{delay}", peer.standing, peer.age_s));
    }
    text
}

/// The lines of the outputs that differ, recorded and replayed.
fn difference_text(flown: &Flown, difference: &Difference) -> String {
    let Difference { step, at_s, recorded, replayed } = difference;
    let mut text = format!("first difference at {at_s:.3} s, step {step}:\n");
    match (recorded, replayed) {
        (Some(recorded), Some(replayed)) => {
            let lines = |outputs: &Outputs| format!("{outputs:#?}").lines().map(str::to_owned).collect::<Vec<_>>();
            let (recorded, replayed) = (lines(recorded), lines(replayed));
            let same = recorded.iter().zip(&replayed).take_while(|(one, other)| one == other).count();
            let rest = |lines: &[String]| lines.get(same..).unwrap_or_default().to_vec();
            let (mut recorded, mut replayed) = (rest(&recorded), rest(&replayed));
            while recorded.last().is_some_and(|last| Some(last) == replayed.last()) {
                recorded.pop();
                replayed.pop();
            }
            recorded.iter().for_each(|line| text += &format!("  in flight  {line}\n"));
            replayed.iter().for_each(|line| text += &format!("  replayed   {line}\n"));
        }
        (None, Some(_)) => text += "  in flight the core panicked, and here it does not\n",
        (_, None) => text += "  the core panics here, and in flight it did not\n",
    }
    let _ = writeln!(text, "release {} flew; another release may give other outputs", flown.release);
    text
}

fn as_json(flown: &Flown, replayed: &Replayed) -> Value {
    let events =
        replayed.events.iter().map(|(at_s, event)| json!({ "at_s": at_s, "event": event, "text": event.to_string() }));
    json!({
        "vehicle": flown.vehicle,
        "incarnation": flown.incarnation,
        "release": flown.release,
        "steps": replayed.steps,
        "end_s": replayed.end_s,
        "events": events.collect::<Vec<_>>(),
        "same": replayed.difference.is_none() && replayed.damage.is_none(),
        "difference": replayed.difference,
        "state": replayed.state,
        "panicked": replayed.has_panicked,
        "cut_off": replayed.is_cut_off,
        "damage": replayed.damage.as_ref().map(ToString::to_string),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_breakpoint_is_a_time_or_part_of_an_event() {
        let at = |text: &str| text.parse::<Break>();
        assert_eq!(at("31.5"), Ok(Break::At(31.5)));
        assert!(at("inf").is_err() && at("").is_err());
        let frozen = at("simulatorlost").unwrap();
        assert!(frozen.is_here(0.0, &[EventKind::AtAltitude, EventKind::SimulatorLost]));
        assert!(
            at("SIMULATOR LOST").unwrap().is_here(0.0, &[EventKind::SimulatorLost]),
            "{}",
            EventKind::SimulatorLost
        );
        assert!(!frozen.is_here(100.0, &[EventKind::OwnDataStale]));
        assert!(at("2").unwrap().is_here(2.0, &[]) && !at("2").unwrap().is_here(1.98, &[]));
    }
}
