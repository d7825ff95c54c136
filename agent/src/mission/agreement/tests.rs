use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::select;

use super::*;

const ROSTER: u8 = 4;
const LAST_STEP: u32 = 3;

fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

fn set(numbers: &[u8]) -> VehicleSet {
    numbers.iter().map(|&number| id(number)).collect()
}

fn active(step: u32, reached: Option<u32>) -> Part {
    Part { incarnation: Incarnation(1), sequence: 5, membership: Membership::Active, step, reached }
}

/// Vehicle 1, active at the first step, which it has reached.
fn there(partition: Partition) -> Agreement {
    let mut agreement = Agreement::new(id(1), ROSTER, LAST_STEP, partition);
    agreement.step(Event::Became(Membership::Active));
    agreement.step(Event::Reached);
    agreement
}

/// The same, who hears these others.
fn among(others: &[(u8, Part)]) -> Agreement {
    let mut agreement = there(Partition::Continue);
    for &(number, part) in others {
        agreement.step(Event::Heard(id(number), part));
    }
    agreement.step(Event::Sees(others.iter().map(|(number, _)| id(*number)).collect()));
    agreement
}

#[test]
fn a_step_is_left_when_the_last_one_reaches_it() {
    let mut agreement = among(&[(2, active(0, Some(0))), (3, active(0, None))]);
    assert_eq!(agreement.step(Event::Free), None);
    assert_eq!(agreement.step(Event::Heard(id(3), active(0, Some(0)))), None);
    assert_eq!(agreement.step(Event::Free), Some(Progress::Advanced));
    assert_eq!((agreement.at(), agreement.reached()), (1, Some(0)));
    assert_eq!(agreement.step(Event::Free), None, "the next one has to be reached first");
}

#[test]
fn who_has_not_reached_the_step_itself_stays_though_all_others_have() {
    let mut agreement = Agreement::new(id(1), ROSTER, LAST_STEP, Partition::Continue);
    agreement.step(Event::Became(Membership::Active));
    agreement.step(Event::Heard(id(2), active(0, Some(0))));
    agreement.step(Event::Sees(set(&[2])));
    assert_eq!(agreement.step(Event::Free), None);
}

#[test]
fn nobody_waits_for_who_joins_or_has_left_or_is_not_heard() {
    for membership in [Membership::Joining, Membership::Left] {
        let mut agreement = among(&[(2, Part { membership, ..active(0, None) })]);
        assert_eq!(agreement.members(), VehicleSet::default());
        assert_eq!(agreement.step(Event::Free), Some(Progress::Advanced), "{membership:?}");
    }
    let mut agreement = among(&[(2, active(0, None))]);
    assert_eq!(agreement.step(Event::Free), None);
    agreement.step(Event::Sees(set(&[])));
    assert_eq!(agreement.step(Event::Free), Some(Progress::Advanced));
}

#[test]
fn who_is_past_a_step_counts_as_having_reached_it() {
    let carried = active(2, Some(0));
    assert!(carried.has_reached(0) && carried.has_reached(1) && !carried.has_reached(2));
    assert!(active(2, Some(2)).has_reached(2));
}

#[test]
fn who_joins_follows_the_others_but_goes_nowhere_by_itself() {
    let mut agreement = Agreement::new(id(1), ROSTER, LAST_STEP, Partition::Continue);
    agreement.step(Event::Reached);
    assert_eq!(agreement.step(Event::Free), None);
    let carried = Progress::Carried { from: 0, reached: true };
    assert_eq!(agreement.step(Event::Heard(id(2), active(2, Some(1)))), Some(carried));
    assert_eq!((agreement.at(), agreement.membership()), (2, Membership::Joining));
}

#[test]
fn a_member_counts_from_the_word_that_says_so() {
    let joining = Part { membership: Membership::Joining, sequence: 4, ..active(0, None) };
    let mut agreement = among(&[(2, joining)]);
    assert_eq!(agreement.members(), set(&[]));
    agreement.step(Event::Heard(id(2), active(0, None)));
    assert_eq!(agreement.members(), set(&[2]));
    assert_eq!(agreement.step(Event::Free), None);
    agreement.step(Event::Heard(id(2), joining));
    assert_eq!(agreement.members(), set(&[2]), "an old word");
}

#[test]
fn a_restart_begins_again_and_its_former_life_is_silent() {
    let mut agreement = among(&[(2, active(0, Some(0)))]);
    let reborn = Part { incarnation: Incarnation(2), sequence: 1, ..active(0, None) };
    agreement.step(Event::Heard(id(2), reborn));
    agreement.step(Event::Heard(id(2), active(0, Some(0))));
    assert_eq!(agreement.part(id(2)), Some(&reborn));
    assert_eq!(agreement.step(Event::Free), None);
}

#[test]
fn who_hears_of_a_later_step_goes_there() {
    let mut agreement = there(Partition::Continue);
    let carried = |from, reached| Some(Progress::Carried { from, reached });
    assert_eq!(agreement.step(Event::Heard(id(2), active(1, None))), carried(0, true));
    assert_eq!(agreement.step(Event::Heard(id(3), active(3, None))), carried(1, false));
    assert_eq!((agreement.at(), agreement.reached()), (3, Some(0)));
    assert_eq!(agreement.step(Event::Heard(id(3), active(2, None))), None);
}

#[test]
fn an_order_carries_forward_never_back_and_never_past_the_last_step() {
    let mut agreement = there(Partition::Continue);
    assert_eq!(agreement.step(Event::Ordered(2)), Some(Progress::Carried { from: 0, reached: true }));
    assert_eq!(agreement.step(Event::Ordered(1)), None);
    assert_eq!(agreement.at(), 2);
    agreement.step(Event::Ordered(u32::MAX));
    assert_eq!(agreement.at(), LAST_STEP);
}

#[test]
fn the_last_step_is_never_left() {
    let mut agreement = there(Partition::Continue);
    agreement.step(Event::Ordered(LAST_STEP));
    agreement.step(Event::Reached);
    assert_eq!((agreement.reached(), agreement.step(Event::Free)), (Some(LAST_STEP), None));
}

#[test]
fn under_quorum_half_of_the_roster_is_not_enough() {
    for (others, enough) in [(&[][..], false), (&[2][..], false), (&[2, 3][..], true), (&[2, 3, 4][..], true)] {
        for (partition, goes_on) in [(Partition::Quorum, enough), (Partition::Continue, true)] {
            let mut agreement = there(partition);
            for number in 2..=ROSTER {
                agreement.step(Event::Heard(id(number), active(0, Some(0))));
            }
            agreement.step(Event::Sees(set(others)));
            assert_eq!(agreement.has_quorum(), goes_on, "{partition:?} with {others:?}");
            assert_eq!(agreement.step(Event::Free).is_some(), goes_on, "{partition:?} with {others:?}");
        }
    }
}

fn membership() -> impl Strategy<Value = Membership> {
    select(&[Membership::Joining, Membership::Active, Membership::Active, Membership::Active, Membership::Left])
}

/// Few lives, few words and few steps, so that they collide. A step reached is one that was entered.
fn part() -> impl Strategy<Value = Part> {
    let step_and_reached = (0..=LAST_STEP).prop_flat_map(|step| (Just(step), proptest::option::of(0..=step)));
    (0_u64..3, 0_u64..4, membership(), step_and_reached).prop_map(|(life, sequence, membership, (step, reached))| {
        Part { incarnation: Incarnation(life), sequence, membership, step, reached }
    })
}

fn vehicle() -> impl Strategy<Value = VehicleId> {
    (1..=ROSTER).prop_map(id)
}

fn word() -> impl Strategy<Value = Event> {
    (vehicle(), part()).prop_map(|(id, part)| Event::Heard(id, part))
}

fn event() -> impl Strategy<Value = Event> {
    prop_oneof![
        4 => word(),
        4 => Just(Event::Reached),
        4 => Just(Event::Free),
        2 => vec(vehicle(), 0..4).prop_map(|heard| Event::Sees(heard.into_iter().collect())),
        1 => (0..=LAST_STEP + 1).prop_map(Event::Ordered),
        1 => membership().prop_map(Event::Became),
    ]
}

fn policy() -> impl Strategy<Value = Partition> {
    select(&[Partition::Continue, Partition::Quorum])
}

/// What was said to an agent, kept word for word.
#[derive(Default)]
struct Witness {
    words: Vec<(VehicleId, Part)>,
    heard: VehicleSet,
}

impl Witness {
    fn note(&mut self, event: Event) {
        match event {
            Event::Heard(id, part) => self.words.push((id, part)),
            Event::Sees(heard) => self.heard = heard,
            _ => {}
        }
    }

    /// Who counts besides vehicle 1, and whether a word of the present life said that it has reached the step.
    fn members(&self, step: u32) -> Vec<bool> {
        let present = (2..=ROSTER).map(id).filter(|id| self.heard.contains(*id)).filter_map(|id| {
            let words = self.words.iter().filter(|(speaker, _)| *speaker == id).map(|(_, part)| *part);
            let life = words.clone().map(|part| part.incarnation).max()?;
            let words = words.filter(move |part| part.incarnation == life);
            let (_, latest) = words.clone().map(|part| (part.sequence, part.membership)).max()?;
            let has_reached = words.clone().any(|part| part.step > step || part.reached >= Some(step));
            (latest == Membership::Active).then_some(has_reached)
        });
        present.collect()
    }
}

proptest! {
    #[test]
    fn merging_a_part_with_itself_changes_nothing(part in part()) {
        prop_assert_eq!(part.merge(part), part);
    }

    #[test]
    fn parts_merge_in_any_order(a in part(), b in part(), c in part()) {
        prop_assert_eq!(a.merge(b), b.merge(a));
        prop_assert_eq!(a.merge(b).merge(c), a.merge(b.merge(c)));
    }

    #[test]
    fn words_lead_to_the_same_knowledge_in_any_order_and_number(
        (words, shuffled) in vec(word(), 0..12).prop_flat_map(|words| {
            let twice = [words.clone(), words.clone()].concat();
            (Just(words), Just(twice).prop_shuffle())
        }),
    ) {
        let told = |words: Vec<Event>| {
            let mut agreement = there(Partition::Continue);
            words.into_iter().for_each(|word| { agreement.step(word); });
            agreement
        };
        prop_assert_eq!(told(words), told(shuffled));
    }

    #[test]
    fn neither_step_nor_reached_ever_goes_back(partition in policy(), events in vec(event(), 0..60)) {
        let mut agreement = Agreement::new(id(1), ROSTER, LAST_STEP, partition);
        for event in events {
            let (step, reached) = (agreement.at(), agreement.reached());
            let progress = agreement.step(event);
            prop_assert!(agreement.at() >= step && agreement.reached() >= reached);
            prop_assert!(agreement.at() <= LAST_STEP && agreement.reached() <= Some(agreement.at()));
            prop_assert_eq!(progress.is_some(), agreement.at() > step);
        }
    }

    #[test]
    fn an_agent_advances_exactly_when_everybody_who_counts_has_said_it_reached_the_step(
        partition in policy(), events in vec(event(), 0..60),
    ) {
        let (mut agreement, mut witness) = (there(partition), Witness::default());
        for event in events {
            let (step, reached, membership) = (agreement.at(), agreement.reached(), agreement.membership());
            let progress = agreement.step(event);
            witness.note(event);
            if event != Event::Free {
                prop_assert_ne!(progress, Some(Progress::Advanced));
                continue;
            }
            let members = witness.members(step);
            let is_enough = partition == Partition::Continue || members.len() + 1 > usize::from(ROSTER) / 2;
            let is_ready = membership == Membership::Active && reached == Some(step) && step < LAST_STEP;
            let may = is_ready && is_enough && members.iter().all(|has_reached| *has_reached);
            prop_assert_eq!(progress, may.then_some(Progress::Advanced));
            prop_assert_eq!(agreement.at(), step + u32::from(may));
        }
    }
}
