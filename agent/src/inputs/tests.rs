use std::path::{Path, PathBuf};
use std::sync::mpsc::Receiver;
use std::{fs, thread};

use skein_common::id::{VehicleId, VehicleName, VehicleSet};
use skein_common::message::{Header, Heartbeat, Order, Verb};
use skein_common::state::Membership;
use skein_common::time::{LocalTime, PlantTime};
use skein_core::builtin::BuiltInPlant;
use skein_core::formation::Workspace;
use skein_core::helicopter::Start;
use skein_core::peers::{PeerMessage, Received};
use skein_core::station::StepInputs;
use tempfile::TempDir;

use super::reader::InputsReader;
use super::*;
use crate::config::InputsFolder;

const SCENARIO: &str = "swarm.vehicles = 2\nnetwork = { loss = 0.2, delay_s = 0.1 }\n";
/// Steps of a test flight: 12 s.
const STEPS: u64 = 600;

fn flown(incarnation: u64) -> Flown {
    Flown {
        release: "test".to_owned(),
        scenario: SCENARIO.to_owned(),
        vehicle: "1".to_owned(),
        incarnation: Incarnation(incarnation),
        flown_s: None,
        aircraft: Aircraft::SHIPPED[0].1.to_owned(),
        rules: None,
    }
}

/// Starts to keep the inputs of an agent in this folder.
fn start(path: &Path, incarnation: u64, all: bool) -> (Recorder, Receiver<()>) {
    let Flown { scenario, aircraft, rules, .. } = flown(incarnation);
    let vehicle = VehicleName::from(VehicleId::new(1).unwrap());
    let folder = InputsFolder { path: path.to_owned(), scenario, vehicle, aircraft, rules };
    Recorder::start(&folder, &flown(incarnation), all).unwrap()
}

fn file_of(path: &Path, incarnation: u64) -> PathBuf {
    path.join(format!("1-{incarnation}.inputs"))
}

/// Flies vehicle 1 with a peer that sends heartbeats, which repeat an order that sets a key. The simulator sends nothing from this step on.
fn fly(recorder: &mut Recorder, silent_from: u64) {
    let flown = flown(1);
    let mut station = flown.station().unwrap();
    let scenario = scenario::load(&Source { name: "test.toml", text: SCENARIO }, &[]).unwrap().scenario;
    let [own, peer] = [1, 2].map(|id| VehicleId::new(id).unwrap());
    let aircraft = Aircraft::from_text("aircraft.toml", &flown.aircraft).unwrap();
    let mut plant = BuiltInPlant::new(&scenario, own, &aircraft, &Start::default()).unwrap();
    let mut workspace = Workspace::default();
    let mut plant_time = PlantTime::ZERO;
    let verb = Verb::Set("formation.altitude_m=40".parse().unwrap());
    let order = Order { epoch: 1, issuer: 2, verb, vehicles: None, signature: None };
    for step in 0..STEPS {
        let right = LocalTime::from_nanoseconds(20_000_000 * step + 137 * (step % 5));
        let frame = (step % 50 != 49 && step < silent_from).then(|| plant.frame());
        plant_time = frame.map_or(plant_time, |frame| frame.time);
        let header = Header { sender: peer, incarnation: Incarnation(3), sequence: step, stamp: right.into() };
        let message = match step {
            10 => Some(PeerMessage::Appeared(peer)),
            _ if step % 10 == 0 => Some(PeerMessage::Mission(Heartbeat {
                header,
                plan: scenario.plan_hash(),
                membership: Membership::Active,
                step: 0,
                vouched: 0,
                reached: None,
                progress_m: 0.0,
                order: Some(order),
                orders: 1,
                echo: None,
                lost: VehicleSet::default(),
            })),
            _ => None,
        };
        let mut inputs = StepInputs {
            right,
            received: message.into_iter().map(|message| Received { message, at: right }).collect(),
            plant_time,
            measurement: frame.map(|frame| frame.measurement),
            ..StepInputs::default()
        };
        recorder.inputs(&inputs);
        let outputs = station.step_with(&mut inputs, &mut workspace);
        recorder.outputs(right, &outputs);
        plant.advance(outputs.command);
    }
    assert_eq!(station.agent().orders().settings().len(), 1);
}

/// The bytes of a flight of which all inputs are kept.
fn recorded() -> Vec<u8> {
    let path = TempDir::new().unwrap();
    let (mut recorder, keeper) = start(path.path(), 1, true);
    fly(&mut recorder, STEPS);
    drop(recorder);
    let _ = keeper.recv_timeout(FINISH_TIMEOUT);
    fs::read(file_of(path.path(), 1)).unwrap()
}

/// Runs the station again. Returns the number of steps that gave the same outputs, until one differs or the file ends.
fn replay(reader: &mut InputsReader<'_>) -> Result<(u64, bool), InputsError> {
    let mut station = reader.flown.station()?;
    let mut workspace = Workspace::default();
    let mut same = 0;
    while let Some(mut step) = reader.next_step()? {
        let outputs = station.step_with(&mut step.inputs, &mut workspace);
        if !step.has_outputs(&outputs) {
            return Ok((same, false));
        }
        same += 1;
    }
    Ok((same, true))
}

#[test]
fn a_replay_gives_every_output_byte_for_byte() {
    let bytes = recorded();
    let mut reader = InputsReader::new(&bytes).unwrap();
    assert_eq!(reader.flown, flown(1));
    assert_eq!(replay(&mut reader).unwrap(), (STEPS, true));
    assert!(!reader.is_cut_off);
    println!("{} bytes a step", bytes.len() as u64 / STEPS);
}

#[test]
fn a_changed_input_changes_the_outputs() {
    let bytes = recorded();
    let mut reader = InputsReader::new(&bytes).unwrap();
    let mut steps = Vec::new();
    while let Some(step) = reader.next_step().unwrap() {
        steps.push(step);
    }
    // One millimetre a second, in one of 600 measurements.
    let measurement = steps[400].inputs.measurement.as_mut().unwrap();
    measurement.velocity.0.z += 0.001;
    let mut content = Vec::new();
    for step in &steps {
        content = encoded_after(encoded_after(content, &step.inputs), step.outputs.as_ref().unwrap());
    }
    let mut changed = beginning(&flown(1));
    changed.extend(chunk(&content));
    let (same, is_whole) = replay(&mut InputsReader::new(&changed).unwrap()).unwrap();
    assert!((400..405).contains(&same) && !is_whole, "{same}");
}

#[test]
fn a_changed_byte_is_found_wherever_it_is() {
    let bytes = recorded();
    for at in (0..bytes.len()).step_by(bytes.len() / 97) {
        let mut changed = bytes.clone();
        changed[at] ^= 0x10;
        let found = InputsReader::new(&changed).and_then(|mut reader| {
            let (same, is_whole) = replay(&mut reader)?;
            // A length that reaches beyond the file looks like a file that was cut off.
            Ok(is_whole && same == STEPS && !reader.is_cut_off)
        });
        assert!(!found.unwrap_or(false), "byte {at}");
    }
}

#[test]
fn a_file_that_was_cut_anywhere_is_readable_up_to_there() {
    let bytes = recorded();
    let mut before = 0;
    for end in (0..bytes.len()).step_by(bytes.len() / 97) {
        match InputsReader::new(&bytes[..end]) {
            Ok(mut reader) => {
                let (same, is_whole) = replay(&mut reader).unwrap();
                assert!(is_whole && same >= before, "{end} bytes: {same} steps");
                before = same;
            }
            Err(InputsError::OtherKind) => assert!(end < MAGIC.len()),
            Err(error) => assert!(matches!(error, InputsError::Empty), "{end} bytes: {error}"),
        }
    }
    assert!(before > STEPS / 2, "{before}");
}

#[test]
fn only_a_fault_leaves_a_file_and_few_old_ones_stay() {
    let path = TempDir::new().unwrap();
    let (mut recorder, keeper) = start(path.path(), 1, false);
    fly(&mut recorder, STEPS);
    drop(recorder);
    let _ = keeper.recv_timeout(FINISH_TIMEOUT);
    assert_eq!(fs::read_dir(path.path()).unwrap().count(), 0);
    for incarnation in 1..12 {
        let (mut recorder, keeper) = start(path.path(), incarnation, false);
        fly(&mut recorder, 300);
        drop(recorder);
        let _ = keeper.recv_timeout(FINISH_TIMEOUT);
    }
    assert_eq!(fs::read_dir(path.path()).unwrap().count(), 8);
    let bytes = fs::read(file_of(path.path(), 11)).unwrap();
    let mut reader = InputsReader::new(&bytes).unwrap();
    assert_eq!(reader.flown.incarnation, Incarnation(11));
    let mut lost = 0;
    while let Some(step) = reader.next_step().unwrap() {
        lost += step.outputs.unwrap().outbox.happened.iter().filter(|event| is_fault(event)).count();
    }
    assert_eq!(lost, 1, "the simulator was lost once");
}

#[test]
fn a_panic_leaves_the_inputs_of_the_step_in_which_it_happened() {
    let path = TempDir::new().unwrap();
    let (mut recorder, keeper) = start(path.path(), 1, false);
    let panicked = thread::spawn(move || {
        recorder.inputs(&StepInputs::default());
        panic!("a bug in the core");
    });
    assert!(panicked.join().is_err());
    let _ = keeper.recv_timeout(FINISH_TIMEOUT);
    let bytes = fs::read(file_of(path.path(), 1)).unwrap();
    let step = InputsReader::new(&bytes).unwrap().next_step().unwrap().unwrap();
    assert_eq!((step.inputs, step.outputs), (StepInputs::default(), None));
}

#[test]
fn a_folder_that_cannot_be_written_changes_nothing_for_the_flight() {
    let (mut recorder, keeper) = start(Path::new("/nowhere/at/all"), 1, true);
    fly(&mut recorder, STEPS);
    drop(recorder);
    let _ = keeper.recv_timeout(FINISH_TIMEOUT);
}

#[test]
fn what_is_no_file_of_inputs_is_refused() {
    let other = |bytes: &[u8]| InputsReader::new(bytes).unwrap_err().to_string();
    assert!(other(b"\x89MCAP0\r\n").starts_with("this is not a file of an agent's inputs"));
    let mut newer = recorded();
    newer[MAGIC.len()] = 9;
    assert!(other(&newer).starts_with("this file has version 9"), "{}", other(&newer));
}
