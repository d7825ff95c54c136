use std::cell::RefCell;
use std::io::Cursor;
use std::path::PathBuf;
use std::rc::Rc;

use skein_common::message::EventKind;
use tempfile::TempDir;

use super::super::fleet::tests::fleet_writer;
use super::super::tests::steps;
use super::super::{FLEET_FILE, RecordingInfo, Sink, Writer, log_time_ns, read};
use super::*;
use crate::metrics::Run;
use crate::scenario::ScenarioArgs;

fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

/// A recording of two vehicles, two seconds long, whose window begins at this log time. Vehicle 2 falls silent after one second.
fn recording(zero_ns: u64) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let loaded = ScenarioArgs::default().read(vec!["swarm.vehicles=2".to_owned()]).unwrap();
    let (scenario, text) = (&loaded.scenario, loaded.to_toml());
    let about = RecordingInfo { scenario, scenario_toml: &text, run: &Run::new(scenario, "fly"), is_fleet: false };
    let mut writer = Writer::begin(Cursor::new(Vec::new()), &about, "", zero_ns).unwrap();
    writer.window_begins(zero_ns);
    let steps = steps();
    let begins = steps[0].plant_time;
    for step in steps {
        let t_s = step.plant_time.seconds_since(begins);
        if step.header.sender == id(1) || t_s < 1.0 {
            writer.step(log_time_ns(zero_ns, t_s), &step);
        }
    }
    writer.event(log_time_ns(zero_ns, 0.5), id(1), None, &EventKind::AtAltitude);
    let path = folder.path().join("run.mcap");
    std::fs::write(&path, writer.finish(0).unwrap().into_inner()).unwrap();
    (folder, path)
}

#[test]
fn at_any_time_and_in_any_order_the_newest_trace_of_each_vehicle_is_played() {
    for zero_ns in [0, 1_700_000_000_000_000_000] {
        let (_folder, path) = recording(zero_ns);
        let whole = read(&path).unwrap();
        let mut player = Player::open(&path).unwrap();
        assert!(!player.is_fleet());
        let (from_s, to_s) = player.span_s();
        assert!((0.0..0.1).contains(&from_s) && (1.9..2.1).contains(&to_s), "{from_s} to {to_s}");
        // Forward in small steps, back, forward again, and beyond the end.
        for at_s in [0.3, 0.31, 0.4, 1.5, 1.9, 0.7, 1.95, 100.0] {
            let played = player.traces(at_s).unwrap();
            for track in &whole.tracks {
                let newest = track.steps.iter().rev().find(|step| step.t_s <= at_s).unwrap();
                assert_eq!(played[&track.id], (newest.t_s, newest.trace.clone()), "{at_s} s");
            }
        }
        // No log time is before 0.
        if zero_ns > 0 {
            assert!(player.traces(-1.0).unwrap().is_empty(), "before the recording");
        }
        let (last_s, _) = player.traces(1.9).unwrap()[&id(2)];
        assert!((0.9..1.0).contains(&last_s), "the last that vehicle 2 sent, at {last_s} s");
        let events = player.events().unwrap();
        assert_eq!(events.len(), 1);
        assert_eq!((events[0].t_s, events[0].vehicle, &*events[0].text), (0.5, Some(id(1).into()), "at altitude"));
    }
}

/// Messages in memory: topic, log time and content.
#[derive(Default)]
struct Memory {
    topics: Vec<String>,
    schemas: u16,
    messages: Vec<(String, u64, Vec<u8>)>,
    /// A topic without readers.
    unread: Option<String>,
}

impl Sink for Rc<RefCell<Memory>> {
    fn add_schema(&mut self, _: &str, _: &str, _: &[u8]) -> Result<u16, RecordError> {
        let mut memory = self.borrow_mut();
        memory.schemas += 1;
        Ok(memory.schemas)
    }

    fn add_channel(&mut self, topic: &str, schema: u16, _: &str) -> Result<u16, RecordError> {
        let mut memory = self.borrow_mut();
        assert!((1..=memory.schemas).contains(&schema));
        memory.topics.push(topic.to_owned());
        Ok(memory.topics.len() as u16 - 1)
    }

    fn is_read(&self, channel: u16) -> bool {
        let memory = self.borrow();
        memory.unread.as_ref() != Some(&memory.topics[usize::from(channel)])
    }

    fn put(&mut self, channel: u16, log_time_ns: u64, message: &[u8]) {
        let mut memory = self.borrow_mut();
        let topic = memory.topics[usize::from(channel)].clone();
        memory.messages.push((topic, log_time_ns, message.to_vec()));
    }
}

#[test]
fn a_replay_sends_every_message_once_and_shows_any_time() {
    let (_folder, path) = recording(5_000_000_000);
    let bytes = std::fs::read(&path).unwrap();
    let mut recorded: Vec<(String, u64, Vec<u8>)> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(|message| message.unwrap())
        .map(|message| (message.channel.topic.clone(), message.log_time, message.data.to_vec()))
        .collect();
    let memory = Rc::new(RefCell::new(Memory::default()));
    let player = Player::open(&path).unwrap();
    let (first_ns, last_ns) = player.span_ns();
    let mut replay = Replay::new(player, Rc::clone(&memory)).unwrap();
    let taken = || std::mem::take(&mut memory.borrow_mut().messages);

    replay.show(first_ns).unwrap();
    let mut played = taken();
    let mut at_ns = first_ns;
    while at_ns < last_ns {
        replay.play(at_ns, at_ns + 130_000_000).unwrap();
        at_ns += 130_000_000;
    }
    played.extend(taken());
    assert!(played.is_sorted_by_key(|(_, log_time_ns, _)| *log_time_ns));
    [&mut played, &mut recorded].into_iter().for_each(|messages| messages.sort());
    assert!(played == recorded, "{} of {} messages", played.len(), recorded.len());

    // At any time: what is drawn, and the newest step of each vehicle.
    replay.show(first_ns + 900_000_000).unwrap();
    let shown = taken();
    let topics: Vec<&str> = shown.iter().map(|(topic, ..)| topic.as_str()).collect();
    for topic in ["/scene/vehicles", "/scene/formation", "/vehicle/1/trace", "/vehicle/2/trace", "/tf"] {
        assert!(topics.contains(&topic), "{topic}");
    }
    assert!(shown.iter().all(|(_, log_time_ns, _)| *log_time_ns <= first_ns + 900_000_000));

    memory.borrow_mut().unread = Some("/tf".to_owned());
    replay.play(first_ns, last_ns).unwrap();
    let played = taken();
    assert!(!played.is_empty() && played.iter().all(|(topic, ..)| topic != "/tf"), "what has no reader is not sent");
}

#[test]
fn a_file_that_is_no_whole_recording_is_refused_with_the_reason() {
    let (folder, path) = recording(0);
    let bytes = std::fs::read(&path).unwrap();
    let other = folder.path().join("other.mcap");
    let refused = |bytes: &[u8]| {
        std::fs::write(&other, bytes).unwrap();
        Player::open(&other).err().unwrap().to_string()
    };
    assert!(refused(&bytes[..bytes.len() - 100]).contains("--repair"), "{}", refused(&bytes[..bytes.len() - 100]));
    for bytes in [&b"not a recording at all, whatever its name"[..], b""] {
        assert!(refused(bytes).contains("other.mcap: "), "{}", refused(bytes));
    }
    assert!(Player::open(&folder.path().join("none.mcap")).err().unwrap().to_string().contains("none.mcap"));
    // Changed bytes anywhere give an error or a recording, never a panic.
    for at in (0..bytes.len()).step_by(97) {
        let mut changed = bytes.clone();
        changed[at] ^= 0x55;
        std::fs::write(&other, &changed).unwrap();
        if let Ok(mut player) = Player::open(&other) {
            let _ = (player.traces(1.5).map(BTreeMap::len), player.events());
        }
    }
}

#[test]
fn a_fleet_moves_from_place_to_place() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(FLEET_FILE);
    let mut writer = fleet_writer(&path, "[fleet]\nteams = 2\n[swarm]\nvehicles = 2\n");
    let place = |number: u8, north_m: f64| VehiclePlace {
        id: id(number),
        step: 1,
        north_m,
        east_m: -12.0,
        altitude_m: 30.0,
        in_place: true,
    };
    for t_s in 0..20_u8 {
        for team in 1..=2 {
            let first = place(1, 10.0 * f64::from(t_s));
            // Vehicle 2 of team 2 is gone after 10 s.
            let second = (team == 1 || t_s <= 10).then(|| place(2, 500.0));
            let vehicles = std::iter::once(first).chain(second).collect();
            let places = TeamPlaces { team: TeamId::new(team).unwrap(), t_s: t_s.into(), vehicles };
            writer.places(log_time_ns(0, places.t_s), &places);
        }
    }
    let sender = VehicleName { team: Some(TeamId::FIRST), vehicle: id(1) };
    writer.event(3_000_000_000, sender, None, &EventKind::Landed);
    writer.finish(0).unwrap();
    let mut player = Player::open(&path).unwrap();
    assert!(player.is_fleet());
    assert_eq!(player.span_s(), (0.0, 19.0));
    for at_s in [4.25, 4.5, 5.5, 18.5, 0.5] {
        let places = player.places(at_s).unwrap();
        let first = places[&TeamId::FIRST][0];
        assert!((first.place.north_m - 10.0 * at_s).abs() < 1e-9, "{at_s} s: {first:?}");
        assert_eq!((first.velocity_ne_m_s, places[&TeamId::FIRST][1].velocity_ne_m_s), ([10.0, 0.0], [0.0, 0.0]));
        assert_eq!(places[&TeamId::new(2).unwrap()].len(), if at_s < 11.0 { 2 } else { 1 });
    }
    assert!(player.places(40.0).unwrap().is_empty(), "after the recording");
    let events = player.events().unwrap();
    assert_eq!((events[0].vehicle.unwrap().to_string(), &*events[0].text), ("1/1".to_owned(), "landed"));
}

/// A record of this kind and content.
fn record(kind: u8, content: &[u8]) -> Vec<u8> {
    [&[kind][..], &(content.len() as u64).to_le_bytes(), content].concat()
}

#[test]
fn an_attachment_without_room_for_its_checksum_is_damaged_wherever_it_is() {
    // Two times, two empty texts, no data, and nothing behind.
    let attachment = record(op::ATTACHMENT, &[0; 32]);
    let (folder, path) = recording(0);
    let whole = std::fs::read(&path).unwrap();
    let damaged = folder.path().join("damaged.mcap");
    let header = MAGIC.len() + PREFIX + usize::try_from(u64::from_le_bytes(whole[9..17].try_into().unwrap())).unwrap();
    std::fs::write(&damaged, [&whole[..header], &attachment[..], &whole[header..]].concat()).unwrap();
    let refused = read(&damaged).unwrap_err().to_string();
    assert!(refused.contains(format::ENDS), "with damage outside chunks the end has to be recorded: {refused}");

    // The summary begins with the attachment.
    let footer = whole.len() - usize::try_from(FOOTER).unwrap();
    let start = usize::try_from(u64::from_le_bytes(whole[footer + 9..footer + 17].try_into().unwrap())).unwrap();
    std::fs::write(&damaged, [&whole[..start], &attachment[..], &whole[start..]].concat()).unwrap();
    assert!(Player::open(&damaged).is_err());
    assert_eq!(read(&damaged).unwrap().tracks.len(), 2, "without the index it is read");
}
