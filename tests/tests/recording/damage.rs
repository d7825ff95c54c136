//! Files that are cut off, damaged, or none at all.

use std::fs;
use std::path::Path;

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use skein_lab::record::{RecordError, merge, read, repair};
use skein_lab::recording::Recording;
use skein_tests::in_parallel;
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

/// Steps of each vehicle, and things noted.
fn sizes(recording: &Recording) -> Vec<usize> {
    let steps = recording.tracks.iter().map(|track| track.steps.len());
    steps.chain([recording.noted.len()]).collect()
}

/// Everything of `part` stands at the beginning of `whole`.
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
    let place = Place(tempfile::tempdir().unwrap());
    let (.., path) = flown(&place.0, &[&SETS[..], &["duration_s=15"]].concat(), 1);
    let (whole, bytes) = (read(&path).unwrap(), fs::read(&path).unwrap());
    let chunks = chunks(&bytes);
    let untouched = repair(&path).unwrap();
    assert_eq!((untouched.to, untouched.messages), (None, chunks.last().unwrap().1));
    let kept: Vec<u64> = in_parallel(0..CUTS, |nth| {
        let cut = ChaCha8Rng::seed_from_u64(nth).random_range(0..bytes.len());
        let path = place.file(&format!("{nth}.mcap"), &bytes[..cut]);
        let kept = chunks.iter().rev().find(|(end, _)| *end <= cut).map_or(0, |(_, so_far)| *so_far);
        if cut < MAGIC {
            assert!(matches!(repair(&path), Err(RecordError::NoMcap)), "cut at {cut}");
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

/// None of these may do more than refuse.
fn suffer(path: &Path, to: &Path) {
    let _ = read(path);
    let _ = repair(path);
    let _ = merge(&[path.to_owned(), path.to_owned()], to);
}

#[test]
fn garbage_is_refused_and_nothing_worse() {
    let place = Place(tempfile::tempdir().unwrap());
    let (.., path) = flown(&place.0, &[&SETS[..], &["duration_s=2"]].concat(), 3);
    let (good, to) = (fs::read(&path).unwrap(), place.0.path().join("merged.mcap"));
    let records = records(&good);
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
        suffer(&place.file("garbage.mcap", &bytes), &to);
    }
    let text = place.file("scenario.mcap", b"[swarm]\nvehicles = 4\n");
    assert!(matches!(read(&text), Err(RecordError::NoMcap)));
    assert_eq!(read(&text).unwrap_err().to_string(), "not an MCAP file");
    let nothing = place.0.path().join("nothing.mcap");
    assert!(matches!(read(&nothing), Err(RecordError::Io { .. })));
    let drafts = fs::read_dir(place.0.path()).unwrap().flatten();
    let drafts = drafts.filter(|entry| entry.path().extension().is_some_and(|extension| extension == "draft"));
    assert_eq!(drafts.count(), 0, "what failed leaves nothing behind");
}

#[test]
fn merged_files_stand_in_the_order_of_time_and_each_step_counts_once() {
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
