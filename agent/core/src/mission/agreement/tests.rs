use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::select;

use skein_common::id::Incarnation;

use super::*;
use crate::testing::id;

const ROSTER: u8 = 4;
const LAST_STEP: u32 = 3;

fn set(numbers: &[u8]) -> VehicleSet {
    numbers.iter().map(|&number| id(number)).collect()
}

fn order(life: u64, sequence: u64) -> MessageOrder {
    MessageOrder { incarnation: Incarnation(life), sequence }
}

fn active(step: u32, reached: Option<u32>) -> Part {
    Part { order: order(1, 5), membership: Membership::Active, step, vouched: step, reached }
}

/// These others are heard. Of the four, those that are not may be flying.
fn sees(numbers: &[u8]) -> Event {
    Event::Sees { heard: set(numbers), misses_any: numbers.len() + 1 < usize::from(ROSTER) }
}

/// These others are heard, and all further ones have left or were silent for long.
fn sees_all_that_are_left(numbers: &[u8]) -> Event {
    Event::Sees { heard: set(numbers), misses_any: false }
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
    agreement.step(sees(&others.iter().map(|(number, _)| *number).collect::<Vec<_>>()));
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
    agreement.step(sees(&[2]));
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
    agreement.step(sees(&[]));
    assert_eq!(agreement.step(Event::Free), Some(Progress::Advanced));
}

#[test]
fn who_is_past_a_step_counts_as_having_reached_it() {
    let carried = active(2, Some(0));
    assert!(carried.has_reached(0) && carried.has_reached(1) && !carried.has_reached(2));
    assert!(active(2, Some(2)).has_reached(2));
}

#[test]
fn a_vehicle_that_joins_follows_two_others_but_goes_nowhere_by_itself() {
    let mut agreement = Agreement::new(id(1), ROSTER, LAST_STEP, Partition::Continue);
    agreement.step(Event::Reached);
    assert_eq!(agreement.step(Event::Free), None);
    agreement.step(Event::Heard(id(2), active(2, Some(1))));
    agreement.step(Event::Heard(id(3), active(2, None)));
    assert_eq!(agreement.step(sees(&[2, 3])), Some(Progress::Carried { from: 0, reached: true }));
    assert_eq!((agreement.at(), agreement.membership()), (2, Membership::Joining));
}

#[test]
fn a_member_counts_from_the_word_that_says_so() {
    let joining = Part { membership: Membership::Joining, order: order(1, 4), ..active(0, None) };
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
    let reborn = Part { order: order(2, 1), ..active(0, None) };
    agreement.step(Event::Heard(id(2), reborn));
    agreement.step(Event::Heard(id(2), active(0, Some(0))));
    assert_eq!(agreement.part(id(2)), Some(&reborn));
    assert_eq!(agreement.step(Event::Free), None);
}

/// Vehicle 1 at the first step, after it has heard these registers and sees these others.
fn after(others: &[(u8, Part)], event: Event) -> (Agreement, Option<Progress>) {
    let mut agreement = there(Partition::Continue);
    for &(number, part) in others {
        assert_eq!(agreement.step(Event::Heard(id(number), part)), None);
    }
    let progress = agreement.step(event);
    (agreement, progress)
}

#[test]
fn one_later_register_carries_no_vehicle_and_two_carry_to_the_step_of_both() {
    let (mut agreement, progress) = after(&[(2, active(3, Some(3))), (3, active(0, None))], sees(&[2, 3]));
    assert_eq!((progress, agreement.at(), agreement.vouched()), (None, 0, 0), "one of them may lie");
    agreement.step(Event::Heard(id(3), active(1, None)));
    assert_eq!(agreement.step(sees(&[2, 3])), Some(Progress::Carried { from: 0, reached: true }));
    assert_eq!((agreement.at(), agreement.vouched(), agreement.reached()), (1, 1, Some(0)));
    agreement.step(Event::Heard(id(4), active(2, None)));
    assert_eq!(agreement.step(sees(&[2, 3, 4])), Some(Progress::Carried { from: 1, reached: false }));
    assert_eq!(agreement.at(), 2, "two are at step 2 or later");
}

#[test]
fn a_vehicle_that_is_not_heard_vouches_for_nothing() {
    let ahead = [(2, active(3, Some(3))), (3, active(3, Some(3)))];
    assert_eq!(after(&ahead, sees(&[2])).1, None);
    assert!(after(&ahead, sees(&[2, 3])).1.is_some());
}

#[test]
fn a_register_alone_carries_only_if_no_other_vehicle_may_be_flying() {
    let ahead = [(2, active(3, Some(2)))];
    assert_eq!(after(&ahead, sees(&[2])).1, None);
    let (mut agreement, progress) = after(&ahead, sees_all_that_are_left(&[2]));
    assert_eq!(progress, Some(Progress::Carried { from: 0, reached: true }));
    assert_eq!((agreement.at(), agreement.vouched()), (3, 0), "it has only one vehicle's register for it");
    agreement.step(Event::Heard(id(3), active(3, None)));
    agreement.step(sees(&[2, 3]));
    assert_eq!(agreement.vouched(), 3, "two vouch for it now");
}

#[test]
fn a_vehicle_that_was_carried_by_one_carries_no_further_one() {
    let misled = Part { vouched: 0, ..active(3, None) };
    let (agreement, progress) = after(&[(2, active(3, None)), (3, misled)], sees(&[2, 3]));
    assert_eq!((progress, agreement.at()), (None, 0));
    assert_eq!(after(&[(3, misled)], sees_all_that_are_left(&[3])).1, None);
    // Nor does what it reaches after that.
    let (mut agreement, _) = after(&[(2, active(2, None))], sees_all_that_are_left(&[2]));
    agreement.step(Event::Reached);
    agreement.step(Event::Heard(id(2), active(3, None)));
    assert_eq!(agreement.step(Event::Free), Some(Progress::Advanced));
    assert_eq!((agreement.at(), agreement.vouched()), (3, 0));
}

#[test]
fn in_a_swarm_of_two_each_follows_the_other() {
    let mut agreement = Agreement::new(id(1), 2, LAST_STEP, Partition::Quorum);
    agreement.step(Event::Heard(id(2), active(2, None)));
    assert!(agreement.step(sees_all_that_are_left(&[2])).is_some());
    assert_eq!((agreement.at(), agreement.vouched()), (2, 2));
}

#[test]
fn a_vehicle_that_ran_ahead_alone_waits_until_the_others_have_come_after_it() {
    let mut others = after(&[(2, active(2, None)), (3, active(0, Some(0)))], sees(&[2, 3])).0;
    assert_eq!(others.step(Event::Free), Some(Progress::Advanced), "it keeps no vehicle from reaching its own step");
    others.step(Event::Reached);
    others.step(Event::Heard(id(3), active(1, Some(1))));
    assert_eq!(others.step(Event::Free), Some(Progress::Advanced));
    let mut ahead = after(&[(2, active(0, None))], sees(&[2])).0;
    ahead.step(Event::Ordered(2));
    ahead.step(Event::Reached);
    assert_eq!(ahead.step(Event::Free), None);
    ahead.step(Event::Heard(id(2), active(2, Some(2))));
    assert_eq!(ahead.step(Event::Free), Some(Progress::Advanced));
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
            agreement.step(sees(others));
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
    let step_vouched_and_reached =
        step_and_reached.prop_flat_map(|(step, reached)| (Just(step), 0..=step, Just(reached)));
    (0_u64..3, 0_u64..4, membership(), step_vouched_and_reached).prop_map(
        |(life, sequence, membership, (step, vouched, reached))| Part {
            order: order(life, sequence),
            membership,
            step,
            vouched,
            reached,
        },
    )
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
        2 => (vec(vehicle(), 0..4), any::<bool>()).prop_map(|(heard, misses_any)| {
            Event::Sees { heard: heard.into_iter().filter(|&heard| heard != id(1)).collect(), misses_any }
        }),
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
            Event::Sees { heard, .. } => self.heard = heard,
            _ => {}
        }
    }

    /// Who counts besides vehicle 1, and whether a word of the present life said that it has reached the step.
    fn members(&self, step: u32) -> Vec<bool> {
        let present = (2..=ROSTER).map(id).filter(|id| self.heard.contains(*id)).filter_map(|id| {
            let words = self.words.iter().filter(|(speaker, _)| *speaker == id).map(|(_, part)| *part);
            let life = words.clone().map(|part| part.order.incarnation).max()?;
            let words = words.filter(move |part| part.order.incarnation == life);
            let (_, latest) = words.clone().map(|part| (part.order, part.membership)).max()?;
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
            agreement.step(sees(&[2, 3, 4]));
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
            prop_assert!(agreement.vouched() <= agreement.at());
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

    #[test]
    fn no_register_of_one_vehicle_moves_another_that_hears_a_third(
        lies in vec(part(), 1..8), honest in part(), misses_any: bool,
    ) {
        let honest = Part { step: 0, vouched: 0, ..honest };
        let mut agreement = there(Partition::Continue);
        agreement.step(Event::Heard(id(2), honest));
        for lie in lies {
            agreement.step(Event::Heard(id(3), lie));
            agreement.step(Event::Sees { heard: set(&[2, 3]), misses_any });
            prop_assert_eq!((agreement.at(), agreement.vouched()), (0, 0));
        }
    }
}
