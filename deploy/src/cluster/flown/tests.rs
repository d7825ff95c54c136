use skein_agent::link::seal::Sealer;
use skein_common::message::Verb;

use super::*;
use crate::keys::folder::new_key;
use crate::keys::run::RunFile;

const OWN: u64 = 7;
const YESTERDAYS: u64 = 5;

fn operator() -> Sealer {
    Sealer::from_pem(&new_key().unwrap()).unwrap()
}

fn lab() -> SwarmName {
    SwarmName::new("lab").unwrap()
}

/// Of a swarm of four, whose vehicles are said to fly in these runs; and of this record of the run begun here.
fn run(named: &[(u8, u64)], own: Option<Record>, notes: &[RunNote], operator: &Sealer) -> Result<Option<u64>, String> {
    let named = named.iter().map(|(id, run)| (VehicleId::new(*id).unwrap(), *run)).collect();
    Evidence { vehicles: 4, named, own, notes }.run(&operator.key(), &lab())
}

#[test]
fn a_single_host_that_names_yesterdays_run_is_not_believed() {
    let operator = operator();
    let note = |run, began_ms| RunNote::new(&operator, &lab(), run, began_ms);
    let yesterdays = Record::of(note(YESTERDAYS, 1000));
    let own = Some(Record::of(note(OWN, 2000)));
    let refused = |own, notes: &[RunNote], why: &str| {
        let error = run(&[(3, YESTERDAYS)], own, notes, &operator).unwrap_err();
        assert!(error.contains(why) && error.contains("node 3 in run 5 said to fly"), "{error}");
        assert!(error.contains("`skein cluster down`") && error.contains("revoke"), "{error}");
    };
    // Whether it has the sealed note of that run or not.
    for notes in [&[][..], &[yesterdays.note]] {
        refused(None, notes, "no run was begun from this PC");
        refused(own, notes, "the run begun here last is 7");
        refused(Some(Record { over: true, ..yesterdays }), notes, "run 5 was ordered to land, or has ended");
    }
    // It was begun here last, but another PC has begun one since.
    refused(Some(yesterdays), &[yesterdays.note, note(OWN, 2000)], "run 7 was begun later from another PC");
    // A note that the operator has not sealed proves nothing, for or against.
    let mut forged = note(OWN, 9000);
    forged.run = 6;
    assert_eq!(run(&[(3, OWN)], own, &[forged], &operator), Ok(Some(OWN)));
    forged.run = YESTERDAYS;
    refused(Some(Record::of(forged)), &[], "of another key");
}

#[test]
fn the_run_that_was_begun_here_is_joined_while_it_is_not_over() {
    let operator = operator();
    let own = Record::of(RunNote::new(&operator, &lab(), OWN, 1000));
    assert_eq!(run(&[(2, OWN)], Some(own), &[], &operator), Ok(Some(OWN)), "one of four is left");
    assert_eq!(run(&[(2, OWN), (3, YESTERDAYS), (4, YESTERDAYS)], Some(own), &[], &operator), Ok(Some(OWN)));
    // That it was ordered to land does not matter to those who are in it.
    let over = Some(Record { over: true, ..own });
    assert_eq!(run(&[(1, OWN), (2, OWN), (3, OWN)], over, &[], &operator), Ok(Some(OWN)));
}

#[test]
fn a_run_is_over_from_the_order_to_land_on() {
    let folder = tempfile::tempdir().unwrap();
    let inventory = crate::inventory::tests::lab(folder.path(), 1, "");
    std::fs::create_dir(&inventory.keys).unwrap();
    let file = RunFile::of(&inventory).unwrap();
    assert_eq!(file.read().unwrap(), None);
    file.note_order(Verb::Abort).unwrap();
    assert_eq!(file.read().unwrap(), None, "of no run");
    let record = Record::of(RunNote::new(&operator(), &lab(), OWN, 1000));
    for (verb, over) in [(Verb::Hold, false), (Verb::Goto(2), false), (Verb::Land, true), (Verb::Abort, true)] {
        file.keep(&record).unwrap();
        file.note_order(verb).unwrap();
        assert_eq!(file.read().unwrap(), Some(Record { over, ..record }), "{verb}");
        // Called back on the way down: the sealed order to land is there all the same.
        file.note_order(Verb::Goto(0)).unwrap();
        assert_eq!(file.read().unwrap().unwrap().over, over);
    }
    std::fs::write(inventory.keys.join("run.json"), "{}").unwrap();
    let error = file.read().unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains("run.json: not the note of a run"), "{error}");
    let plain = crate::inventory::tests::lab(folder.path(), 1, "security = 'none'");
    assert!(RunFile::of(&plain).is_none());
}

#[test]
fn more_than_half_of_all_vehicles_prove_a_run_and_half_do_not() {
    let operator = operator();
    let named = |runs: &[u64]| {
        let named: Vec<(u8, u64)> = (1..).zip(runs.iter().copied()).collect();
        run(&named, None, &[], &operator)
    };
    assert_eq!(named(&[]), Ok(None), "nothing flies: a new one");
    assert_eq!((named(&[8, 8, 8]), named(&[5, 8, 8, 8])), (Ok(Some(8)), Ok(Some(8))));
    for undecided in [&[8][..], &[8, 8], &[8, 8, 5, 5], &[8, 8, 5, 6]] {
        assert!(named(undecided).is_err(), "{undecided:?}");
    }
    let error = named(&[8, 8, 5, 5]).unwrap_err();
    assert!(error.contains("node 3, 4 in run 5; node 1, 2 in run 8 said to fly"), "{error}");
    assert!(error.contains("no run has a majority of the 4 vehicles"), "{error}");
}
