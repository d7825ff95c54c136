//! Files that are cut off, damaged, or none at all.

use std::fs;
use std::path::Path;
use std::sync::LazyLock;

use proptest::prelude::*;
use proptest::sample::Index;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use skein_common::message::Trace;
use skein_lab::record::{RecordError, Repaired, merge, read, repair};
use skein_lab::recording::{Recording, Step};
use skein_tests::in_parallel;
use skein_tests::share::Share;
use tempfile::TempDir;

use super::{SETS, flown};

/// How many files are cut.
const CUTS: u64 = 1_000;
/// What a file of MCAP begins with.
const MAGIC: usize = 8;
/// Kind and length before the content of a record.
const PREFIX: usize = 9;

/// Kind, beginning and end of every record, summary included.
fn records(file: &[u8]) -> Vec<(u8, usize, usize)> {
    let mut records: Vec<(u8, usize, usize)> = Vec::new();
    let mut at = MAGIC;
    while at + PREFIX <= file.len() - MAGIC {
        let length = u64::from_le_bytes(file[at + 1..at + PREFIX].try_into().unwrap()) as usize;
        records.push((file[at], at, at + PREFIX + length));
        at += PREFIX + length;
    }
    assert_eq!(at, file.len() - MAGIC);
    records
}

/// Where every chunk ends, with the messages in all chunks so far.
fn chunks(file: &[u8]) -> Vec<(usize, u64)> {
    let mut so_far = 0;
    let chunks = records(file).into_iter().filter(|(kind, ..)| *kind == mcap::records::op::CHUNK);
    let chunk = |(kind, start, end): (u8, usize, usize)| {
        let record = mcap::parse_record(kind, &file[start + PREFIX..end]).unwrap();
        let mcap::records::Record::Chunk { header, data } = record else { panic!("a chunk") };
        let within = mcap::read::ChunkReader::new(header, &data).unwrap();
        so_far += within.filter(|record| matches!(record, Ok(mcap::records::Record::Message { .. }))).count() as u64;
        (end, so_far)
    };
    chunks.map(chunk).collect()
}

/// Number of steps of each vehicle, then the number of notes.
fn sizes(recording: &Recording) -> Vec<usize> {
    let steps = recording.tracks.iter().map(|track| track.steps.len());
    steps.chain([recording.noted.len()]).collect()
}

/// Whether `whole` begins with everything in `part`.
fn is_beginning(part: &Recording, whole: &Recording) -> bool {
    let tracks = part.tracks.iter().zip(&whole.tracks);
    part.scenario == whole.scenario
        && part.run == whole.run
        && tracks.into_iter().all(|(part, whole)| whole.steps.starts_with(&part.steps))
        && whole.noted.starts_with(&part.noted)
}

struct Place(TempDir);

impl Place {
    fn file(&self, name: &str, bytes: &[u8]) -> std::path::PathBuf {
        let path = self.0.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    }
}

#[test]
fn a_file_cut_anywhere_is_repaired_up_to_its_last_whole_chunk() {
    let _share = Share::of(100);
    let place = Place(tempfile::tempdir().unwrap());
    let (.., path) = flown(&place.0, &[&SETS[..], &["duration_s=50"]].concat(), 1);
    let (whole, bytes) = (read(&path).unwrap(), fs::read(&path).unwrap());
    let chunks = chunks(&bytes);
    let untouched = repair(&path).unwrap();
    assert_eq!((untouched.to, untouched.messages), (None, chunks.last().unwrap().1));
    let kept: Vec<u64> = in_parallel(0..CUTS, |nth| {
        let cut = ChaCha8Rng::seed_from_u64(nth).random_range(0..bytes.len());
        let path = place.file(&format!("{nth}.mcap"), &bytes[..cut]);
        let kept = chunks.iter().rev().find(|(end, _)| *end <= cut).map_or(0, |(_, so_far)| *so_far);
        if cut < MAGIC {
            assert!(repair(&path).unwrap_err().to_string().ends_with("not an MCAP file"), "cut at {cut}");
            return 0;
        }
        let repaired = repair(&path).unwrap();
        assert_eq!((repaired.messages, repaired.damaged), (kept, 0), "cut at {cut}");
        let to = repaired.to.unwrap();
        // Reading it all takes longer.
        if nth % 20 == 0 && kept > 0 {
            let (cut_off, repaired) = (read(&path).unwrap(), read(&to).unwrap());
            assert_eq!(cut_off, repaired, "cut at {cut}");
            assert!(is_beginning(&repaired, &whole), "cut at {cut}: {:?}", sizes(&repaired));
            assert_eq!(repair(&to).unwrap().to, None, "a repaired file is whole");
        }
        [path, to].iter().for_each(|path| fs::remove_file(path).unwrap());
        kept
    });
    let somewhere = kept.iter().filter(|kept| **kept > 0).count();
    assert!(chunks.len() >= 8 && somewhere > 800, "{} chunks, {somewhere}", chunks.len());
}

#[test]
fn a_damaged_chunk_costs_only_itself() {
    let _share = Share::of(100);
    let place = Place(tempfile::tempdir().unwrap());
    let (.., path) = flown(&place.0, &[&SETS[..], &["duration_s=10"]].concat(), 2);
    let bytes = fs::read(&path).unwrap();
    let chunks = chunks(&bytes);
    let (before, within) = (chunks[chunks.len() / 2 - 1], chunks[chunks.len() / 2]);
    let mut damaged = bytes.clone();
    damaged[within.0 - 40] ^= 0x10;
    let damaged = place.file("damaged.mcap", &damaged);
    let repaired = repair(&damaged).unwrap();
    assert_eq!(repaired.damaged, 1);
    assert_eq!(repaired.messages, chunks[chunks.len() - 1].1 - (within.1 - before.1));
    let (left, all) = (read(&repaired.to.unwrap()).unwrap(), read(&path).unwrap());
    for (left, all) in left.tracks.iter().zip(&all.tracks) {
        assert!(left.steps.len() < all.steps.len() && left.steps.iter().all(|step| all.steps.contains(step)));
        assert_eq!(left.steps.last(), all.steps.last(), "what stands behind is there");
    }
}

/// Every step in the file, in its order, with its log time: read by the MCAP library, not by ours.
fn written(file: &[u8]) -> Vec<(u64, Trace)> {
    let messages = mcap::MessageStream::new(file).unwrap().map(Result::unwrap);
    let traces = messages.filter(|message| message.channel.topic.ends_with("/trace"));
    traces.map(|message| (message.log_time, serde_json::from_slice(&message.data).unwrap())).collect()
}

/// Everything read is part of the whole, bit for bit and in its order, and the same steps were written to the file.
fn assert_nothing_is_invented(part: &Recording, whole: &Recording) {
    let same_bits = |one: &Step, other: &Step| {
        // As JSON also zeros have their sign.
        one.t_s.to_bits() == other.t_s.to_bits()
            && (one.trace == other.trace)
            && serde_json::to_string(&one.trace).unwrap() == serde_json::to_string(&other.trace).unwrap()
    };
    assert_eq!((&part.scenario, &part.run, part.tracks.len()), (&whole.scenario, &whole.run, whole.tracks.len()));
    for (part, whole) in part.tracks.iter().zip(&whole.tracks) {
        let mut rest = whole.steps.iter();
        let is_in_order = part.steps.iter().all(|step| rest.any(|original| same_bits(step, original)));
        assert!(part.id == whole.id && is_in_order, "vehicle {}: {} steps", part.id, part.steps.len());
    }
    let mut rest = whole.noted.iter();
    assert!(part.noted.iter().all(|noted| rest.any(|original| noted == original)), "{:?}", part.noted);
}

/// Refused by name of the file, or read without anything invented. Gives how many steps were read, or `None`.
fn refused_or_part_of(path: &Path, whole: &Recording) -> Option<usize> {
    match read(path) {
        Ok(part) => {
            assert_nothing_is_invented(&part, whole);
            Some(part.tracks.iter().map(|track| track.steps.len()).sum())
        }
        Err(error) => {
            assert!(error.to_string().contains(&path.display().to_string()), "{error}");
            None
        }
    }
}

/// What is repaired or merged of a damaged file holds what is read of it; what is refused is refused by all three.
fn assert_repaired_and_merged_alike(path: &Path, to: &Path, whole: &Recording) {
    let read_steps = refused_or_part_of(path, whole);
    let named = |error: RecordError| assert!(error.to_string().contains(&path.display().to_string()), "{error}");
    match repair(path) {
        Ok(Repaired { to: Some(repaired), .. }) => {
            let steps = refused_or_part_of(&repaired, whole);
            assert!(read_steps.is_none() || steps == read_steps, "{steps:?} after repair, {read_steps:?} before");
        }
        Ok(Repaired { to: None, .. }) => assert!(read_steps.is_some(), "nothing to repair, and it cannot be read"),
        Err(error) => named(error),
    }
    match merge(&[path.to_owned(), path.to_owned()], to) {
        Ok(_) => {
            let steps = refused_or_part_of(to, whole);
            assert!(read_steps.is_none() || steps == read_steps, "{steps:?} merged, {read_steps:?} alone");
        }
        Err(error) => named(error),
    }
}

#[test]
fn of_garbage_only_what_was_written_is_read_repaired_and_merged() {
    let _share = Share::of(100);
    let place = Place(tempfile::tempdir().unwrap());
    let (.., path) = flown(&place.0, &[&SETS[..], &["duration_s=2"]].concat(), 3);
    let (good, to) = (fs::read(&path).unwrap(), place.0.path().join("merged.mcap"));
    let (records, whole) = (records(&good), read(&path).unwrap());
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for nth in 0..400 {
        let mut bytes = good.clone();
        match nth % 4 {
            // Noise alone, or behind the right beginning.
            0 => {
                bytes.truncate(rng.random_range(0..4_000));
                let from = if nth % 8 == 0 { 0 } else { MAGIC.min(bytes.len()) };
                rng.fill_bytes(&mut bytes[from..]);
            }
            // A few bytes anywhere.
            1 => (0..rng.random_range(1..20)).for_each(|_| {
                let at = rng.random_range(0..bytes.len());
                bytes[at] = rng.random();
            }),
            // A record of another kind or length.
            2 => {
                let (_, start, _) = records[rng.random_range(0..records.len())];
                let at = start + rng.random_range(0..PREFIX);
                bytes[at] = rng.random();
            }
            // Numbers inside a record's head: sizes, counts, ids.
            _ => {
                let (_, start, end) = records[rng.random_range(0..records.len())];
                let at = start + PREFIX + rng.random_range(0..(end - start - PREFIX).clamp(1, 60));
                bytes[at.min(good.len() - 1)] = *[0, 1, 0x7f, 0xff].get(rng.random_range(0..4)).unwrap();
            }
        }
        assert_repaired_and_merged_alike(&place.file("garbage.mcap", &bytes), &to, &whole);
    }
    let text = place.file("scenario.mcap", b"[swarm]\nvehicles = 4\n");
    assert_eq!(read(&text).unwrap_err().to_string(), format!("{}: not an MCAP file, so no recording", text.display()));
    let nothing = place.0.path().join("nothing.mcap");
    assert!(matches!(read(&nothing), Err(RecordError::Io { .. })));
    let drafts = fs::read_dir(place.0.path()).unwrap().flatten();
    let drafts = drafts.filter(|entry| entry.path().extension().is_some_and(|extension| extension == "draft"));
    assert_eq!(drafts.count(), 0, "what failed leaves nothing behind");
}

#[test]
fn merged_files_stand_in_the_order_of_time_and_each_step_counts_once() {
    let _share = Share::of(100);
    let place = Place(tempfile::tempdir().unwrap());
    let (.., one) = flown(&place.0, &[&SETS[..], &["duration_s=12"]].concat(), 4);
    let to = place.0.path().join("twice.mcap");
    let messages = chunks(&fs::read(&one).unwrap()).last().unwrap().1;
    assert_eq!(merge(&[one.clone(), one.clone()], &to).unwrap(), 2 * messages);
    let (twice, once) = (read(&to).unwrap(), read(&one).unwrap());
    assert_eq!((twice.tracks, twice.noted), (once.tracks, once.noted));
    let (.., other) = flown(&place.0, &[&SETS[..], &["duration_s=9"]].concat(), 5);
    let both = place.0.path().join("both.mcap");
    merge(&[one, other], &both).unwrap();
    let bytes = fs::read(&both).unwrap();
    let stream = mcap::MessageStream::new(&bytes).unwrap();
    let times: Vec<u64> = stream.map(|message| message.unwrap().log_time).collect();
    assert!(times.is_sorted() && times.len() as u64 > messages);
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    assert_eq!((summary.schemas.len(), summary.channels.len()), (7, 2 * 3 + 6), "each once");
    assert_eq!(summary.attachment_indexes.len(), 2, "two scenarios that differ");
}

/// A flight with a cut link and a dead vehicle, and what is read of its whole recording.
static FLIGHT: LazyLock<(Vec<u8>, Recording)> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let (.., path) = flown(&folder, &[&SETS[..], &["duration_s=12"]].concat(), 6);
    (fs::read(&path).unwrap(), read(&path).unwrap())
});

/// What can be done to a file.
#[derive(Clone, Debug)]
enum Harm {
    /// Nothing is left from this byte on.
    Cut(Index),
    /// Bytes from this one on are others.
    Bytes(Index, Vec<u8>),
    /// Bytes from this one on are zero: also of a checksum.
    Zeros(Index, usize),
    /// The same within the first bytes of a record: its kind, its length, numbers, names and texts.
    Head(Index, usize, Vec<u8>),
    /// Bytes are missing here.
    Gap(Index, usize),
}

impl Harm {
    fn apply(&self, bytes: &mut Vec<u8>) {
        let length = bytes.len();
        if length == 0 {
            return;
        }
        let mut overwrite = |at: usize, with: &[u8]| {
            bytes[at..].iter_mut().zip(with).for_each(|(byte, other)| *byte = *other);
        };
        match self {
            Self::Cut(at) => bytes.truncate(at.index(length)),
            Self::Bytes(at, others) => overwrite(at.index(length), others),
            Self::Zeros(at, count) => overwrite(at.index(length), &vec![0; *count]),
            Self::Head(record, offset, others) => {
                // Of the whole file: after other harm this one has no records to go by.
                let records = records(&FLIGHT.0);
                let (_, start, end) = records[record.index(records.len())];
                overwrite((start + offset % (end - start)).min(length - 1), others);
            }
            Self::Gap(at, count) => {
                let at = at.index(length);
                bytes.drain(at..(at + count).min(length));
            }
        }
    }
}

fn harm() -> impl Strategy<Value = Harm> {
    let others = || prop::collection::vec(any::<u8>(), 1..8);
    prop_oneof![
        any::<Index>().prop_map(Harm::Cut),
        (any::<Index>(), others()).prop_map(|(at, others)| Harm::Bytes(at, others)),
        (any::<Index>(), 1..40_usize).prop_map(|(at, count)| Harm::Zeros(at, count)),
        (any::<Index>(), 0..9_usize, others()).prop_map(|(record, offset, others)| Harm::Head(record, offset, others)),
        (any::<Index>(), 0..120_usize, others())
            .prop_map(|(record, offset, others)| Harm::Head(record, offset, others)),
        (any::<Index>(), 1..40_usize).prop_map(|(at, count)| Harm::Gap(at, count)),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn of_a_cut_or_damaged_recording_only_steps_that_were_written_are_read(harms in prop::collection::vec(harm(), 1..3)) {
        let (good, whole) = &*FLIGHT;
        let mut bytes = good.clone();
        harms.iter().for_each(|harm| harm.apply(&mut bytes));
        let place = Place(tempfile::tempdir().unwrap());
        refused_or_part_of(&place.file("harmed.mcap", &bytes), whole);
    }
}

/// The reader of this test set is held against the MCAP library's own: what is read of a whole file is what was written.
#[test]
fn of_a_whole_recording_every_step_of_the_window_is_read() {
    let _share = Share::of(100);
    let (bytes, whole) = &*FLIGHT;
    let written = written(bytes);
    let read: usize = whole.tracks.iter().map(|track| track.steps.len()).sum();
    assert!(read > 200 && read == written.len(), "{read} of {}", written.len());
    for track in &whole.tracks {
        let own = written.iter().filter(|(_, trace)| trace.header.sender == track.id);
        assert!(
            own.zip(&track.steps).all(|((at_ns, trace), step)| *trace == step.trace && *at_ns as f64 / 1e9 == step.t_s)
        );
    }
}

#[test]
fn where_the_beginning_of_the_window_is_damaged_reading_is_refused() {
    let _share = Share::of(100);
    let (good, _) = &*FLIGHT;
    let at = |text: &[u8]| good.windows(text.len()).position(|bytes| bytes == text).unwrap();
    let (name, place) = (at(b"skein.window_begins"), Place(tempfile::tempdir().unwrap()));
    let behind_name = |text: &[u8]| name + good[name..].windows(text.len()).position(|bytes| bytes == text).unwrap();
    // A digit of the time, the name of the record, and the name of the checksum.
    for (at, byte) in [(behind_name(b"log_time_ns") + 15, b'7'), (name, b'x'), (behind_name(b"skein.checksum"), b'x')] {
        let mut bytes = good.clone();
        bytes[at] = byte;
        let path = place.file("window.mcap", &bytes);
        let refused = read(&path).map(|recording| sizes(&recording));
        let error = refused.unwrap_err().to_string();
        assert!(error.starts_with(&path.display().to_string()) && error.ends_with(" is missing"), "{error}");
    }
}
