use std::sync::LazyLock;

use proptest::prelude::*;
use skein_agent::link::signature::SigningKey;
use skein_common::message::Verb;

use super::*;
use crate::keys::folder::new_key;
use crate::keys::run::RunFile;

const OWN: u64 = 7;
const YESTERDAYS: u64 = 5;

fn operator() -> SigningKey {
    SigningKey::from_pem(&new_key().unwrap()).unwrap()
}

fn lab() -> SwarmName {
    SwarmName::new("lab").unwrap()
}

/// The run of a swarm of four whose vehicles are reported to fly in these runs, with this record of the run begun from
/// this PC.
fn run(
    reported: &[(u8, u64)],
    own: Option<Record>,
    notes: &[RunNote],
    operator: &SigningKey,
) -> Result<Option<u64>, String> {
    let reported = reported.iter().map(|(id, run)| (id.to_string().parse().unwrap(), *run)).collect();
    Evidence { vehicles: 4, reported, own, notes }.run(&operator.key(), &lab())
}

#[test]
fn a_single_report_of_an_old_run_is_not_accepted() {
    let operator = operator();
    let note = |run, began_ms| RunNote::new(&operator, &lab(), run, began_ms);
    let yesterdays = Record::of(note(YESTERDAYS, 1000));
    let own = Some(Record::of(note(OWN, 2000)));
    let refused = |own, notes: &[RunNote], why: &str| {
        let error = run(&[(3, YESTERDAYS)], own, notes, &operator).unwrap_err();
        assert!(error.contains(why) && error.contains("node 3 in run 5 reported to fly"), "{error}");
        assert!(error.contains("`skein cluster down`") && error.contains("revoke"), "{error}");
    };
    // With or without the signed note of that run.
    for notes in [&[][..], &[yesterdays.note]] {
        refused(None, notes, "no run was begun from this PC");
        refused(own, notes, "the run begun last from this PC is 7");
        refused(Some(Record { over: true, ..yesterdays }), notes, "run 5 was ordered to land, or has ended");
    }
    // This PC began it last, but another PC has begun a run since.
    refused(Some(yesterdays), &[yesterdays.note, note(OWN, 2000)], "run 7 was begun later from another PC");
    // A note that the operator has not signed proves nothing.
    let mut forged = note(OWN, 9000);
    forged.run = 6;
    assert_eq!(run(&[(3, OWN)], own, &[forged], &operator), Ok(Some(OWN)));
    forged.run = YESTERDAYS;
    refused(Some(Record::of(forged)), &[], "with another key");
}

#[test]
fn the_run_begun_from_this_pc_is_joined_until_it_is_over() {
    let operator = operator();
    let own = Record::of(RunNote::new(&operator, &lab(), OWN, 1000));
    assert_eq!(run(&[(2, OWN)], Some(own), &[], &operator), Ok(Some(OWN)), "one of four is left");
    assert_eq!(run(&[(2, OWN), (3, YESTERDAYS), (4, YESTERDAYS)], Some(own), &[], &operator), Ok(Some(OWN)));
    // The order to land does not matter to vehicles that are already in the run.
    let over = Some(Record { over: true, ..own });
    assert_eq!(run(&[(1, OWN), (2, OWN), (3, OWN)], over, &[], &operator), Ok(Some(OWN)));
}

#[test]
fn a_run_is_over_as_soon_as_it_is_ordered_to_land() {
    let folder = tempfile::tempdir().unwrap();
    let inventory = crate::inventory::tests::lab(folder.path(), 1, "");
    std::fs::create_dir(&inventory.keys).unwrap();
    let file = RunFile::of(&inventory).unwrap();
    assert_eq!(file.read().unwrap(), None);
    file.note_order(Verb::Abort).unwrap();
    assert_eq!(file.read().unwrap(), None, "no run was begun");
    let record = Record::of(RunNote::new(&operator(), &lab(), OWN, 1000));
    for (verb, over) in [(Verb::Hold, false), (Verb::Goto(2), false), (Verb::Land, true), (Verb::Abort, true)] {
        file.keep(&record).unwrap();
        file.note_order(verb).unwrap();
        assert_eq!(file.read().unwrap(), Some(Record { over, ..record }), "{verb}");
        // The vehicles are recalled during the descent, but the signed order to land still exists.
        file.note_order(Verb::Goto(0)).unwrap();
        assert_eq!(file.read().unwrap().unwrap().over, over);
    }
    std::fs::write(inventory.keys.join("run.json"), "{}").unwrap();
    let error = file.read().unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains("run.json: not the record of a run"), "{error}");
    let plain = crate::inventory::tests::lab(folder.path(), 1, "security = 'none'");
    assert!(RunFile::of(&plain).is_none());
}

#[test]
fn a_run_is_proven_by_more_than_half_of_all_vehicles() {
    let operator = operator();
    let reported = |runs: &[u64]| {
        let reported: Vec<(u8, u64)> = (1..).zip(runs.iter().copied()).collect();
        run(&reported, None, &[], &operator)
    };
    assert_eq!(reported(&[]), Ok(None), "nothing flies: a new one");
    assert_eq!((reported(&[8, 8, 8]), reported(&[5, 8, 8, 8])), (Ok(Some(8)), Ok(Some(8))));
    for undecided in [&[8][..], &[8, 8], &[8, 8, 5, 5], &[8, 8, 5, 6]] {
        assert!(reported(undecided).is_err(), "{undecided:?}");
    }
    let error = reported(&[8, 8, 5, 5]).unwrap_err();
    assert!(error.contains("node 3, 4 in run 5; node 1, 2 in run 8 reported to fly"), "{error}");
    assert!(error.contains("no run has a majority of the 4 vehicles"), "{error}");
}

/// Keys of the operator and of an attacker.
static KEYS: LazyLock<[SigningKey; 2]> = LazyLock::new(|| [operator(), operator()]);

/// A run, when it began, and whether the operator has signed the note of it.
type Noted = (u64, u64, bool);

fn noted() -> impl Strategy<Value = Noted> {
    (5..9_u64, 1..5_u64, any::<bool>())
}

fn note((run, began_ms, is_signed): Noted) -> RunNote {
    RunNote::new(&KEYS[usize::from(!is_signed)], &lab(), run, began_ms)
}

proptest! {
    #[test]
    fn no_run_is_joined_without_proof_and_none_is_begun_beside_another(
        reported in prop::collection::btree_map(1..5_u8, 5..9_u64, 0..5),
        own in prop::option::of((noted(), any::<bool>())),
        noted in prop::collection::vec(noted(), 0..4),
    ) {
        let [operator, _] = &*KEYS;
        let reported: Vec<(u8, u64)> = reported.into_iter().collect();
        let record = own.map(|(own, over)| Record { over, ..Record::of(note(own)) });
        let notes: Vec<RunNote> = noted.iter().copied().map(note).collect();
        let decided = run(&reported, record, &notes, operator);
        let reports = |run: u64| reported.iter().filter(|(_, other)| *other == run).count();
        match &decided {
            Ok(Some(run)) => {
                let is_newest = |began_ms| noted.iter().all(|(_, at_ms, is_signed)| !is_signed || *at_ms <= began_ms);
                let is_own = own.is_some_and(|((own, began_ms, is_signed), over)| {
                    own == *run && is_signed && !over && is_newest(began_ms) && reports(own) > 0
                });
                prop_assert!(reports(*run) > 2 || is_own, "{} is not proven", run);
            }
            Ok(None) => prop_assert!(reported.is_empty()),
            Err(why) => {
                prop_assert!(!reported.is_empty() && (5..9).all(|run| reports(run) <= 2), "{}", why);
                prop_assert!(why.contains("`skein cluster down`"), "{}", why);
            }
        }
        // Neither the order of the notes matters, nor a note that the operator has not signed.
        let signed = notes.iter().rev().filter(|note| note.is_signed(&operator.key(), &lab()));
        let signed: Vec<RunNote> = signed.copied().collect();
        prop_assert_eq!(run(&reported, record, &signed, operator).ok(), decided.ok());
    }
}
