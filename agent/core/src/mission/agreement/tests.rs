use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::select;

use skein_common::id::{VehicleId, VehicleSet};

use super::*;
use crate::testing::id;

const ROSTER: u8 = 4;
const LAST_STEP: u32 = 3;

fn set(numbers: &[u8]) -> VehicleSet {
    numbers.iter().map(|&number| id(number)).collect()
}

fn active(step: u32, reached: Option<u32>) -> Part {
    Part { membership: Membership::Active, step, vouched: step, reached }
}

/// Something that happens to vehicle 1.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Event {
    /// A newer record of another vehicle.
    Heard(VehicleId, Part),
    Reached,
    Ordered(u32),
    Became(Membership),
    Sees {
        heard: VehicleSet,
        misses_any: bool,
    },
    Free,
}

/// These others are heard. Of the four, those that are not may be flying.
fn sees(numbers: &[u8]) -> Event {
    Event::Sees { heard: set(numbers), misses_any: numbers.len() + 1 < usize::from(ROSTER) }
}

/// These others are heard, and all further ones have left or were silent for long.
fn sees_all_that_are_left(numbers: &[u8]) -> Event {
    Event::Sees { heard: set(numbers), misses_any: false }
}

/// Vehicle 1's side of the agreement, and what its other stages know.
#[derive(Clone, Debug)]
struct One {
    agreement: Agreement,
    /// The newest record of each of the others.
    parts: Vec<(VehicleId, Part)>,
    heard: VehicleSet,
    misses_any: bool,
}

impl One {
    fn new(roster: u8, partition: Partition) -> Self {
        let (agreement, heard) = (Agreement::new(roster, LAST_STEP, partition), VehicleSet::default());
        Self { agreement, parts: Vec::new(), heard, misses_any: true }
    }

    fn step(&mut self, event: Event) -> Option<Progress> {
        let mut agreement = self.agreement.clone();
        let mut progress = None;
        match event {
            Event::Heard(id, part) => {
                self.parts.retain(|(known, _)| *known != id);
                self.parts.push((id, part));
            }
            Event::Reached => agreement.reach(),
            Event::Ordered(step) => progress = agreement.order(step),
            Event::Became(membership) => agreement.turn(membership),
            Event::Sees { heard, misses_any } => {
                (self.heard, self.misses_any) = (heard, misses_any);
                progress = agreement.follow(&self.others());
            }
            Event::Free => progress = agreement.advance(&self.others()),
        }
        self.agreement = agreement;
        progress
    }

    fn others(&self) -> Others<impl Iterator<Item = Part> + Clone> {
        let in_contact = self.parts.iter().filter(|(id, _)| self.heard.contains(*id));
        Others { parts: in_contact.map(|(_, part)| *part), misses_any: self.misses_any }
    }

    fn has_quorum(&self) -> bool {
        self.agreement.has_quorum(&self.others())
    }

    fn membership(&self) -> Membership {
        self.agreement.own().membership
    }

    fn at(&self) -> u32 {
        self.agreement.own().step
    }

    fn vouched(&self) -> u32 {
        self.agreement.own().vouched
    }

    fn reached(&self) -> Option<u32> {
        self.agreement.own().reached
    }
}

/// Vehicle 1, active at the first step, which it has reached.
fn there(partition: Partition) -> One {
    let mut one = One::new(ROSTER, partition);
    one.step(Event::Became(Membership::Active));
    one.step(Event::Reached);
    one
}

/// The same, in contact with these others.
fn among(others: &[(u8, Part)]) -> One {
    let mut one = there(Partition::Continue);
    for &(number, part) in others {
        one.step(Event::Heard(id(number), part));
    }
    one.step(sees(&others.iter().map(|(number, _)| *number).collect::<Vec<_>>()));
    one
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
    let mut agreement = One::new(ROSTER, Partition::Continue);
    agreement.step(Event::Became(Membership::Active));
    agreement.step(Event::Heard(id(2), active(0, Some(0))));
    agreement.step(sees(&[2]));
    assert_eq!(agreement.step(Event::Free), None);
}

#[test]
fn nobody_waits_for_who_joins_or_has_left_or_is_not_heard() {
    for membership in [Membership::Joining, Membership::Left] {
        let mut agreement = among(&[(2, Part { membership, ..active(0, None) })]);
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
    let mut agreement = One::new(ROSTER, Partition::Continue);
    agreement.step(Event::Reached);
    assert_eq!(agreement.step(Event::Free), None);
    agreement.step(Event::Heard(id(2), active(2, Some(1))));
    agreement.step(Event::Heard(id(3), active(2, None)));
    assert_eq!(agreement.step(sees(&[2, 3])), Some(Progress::Carried { from: 0, reached: true }));
    assert_eq!((agreement.at(), agreement.membership()), (2, Membership::Joining));
}

#[test]
fn a_member_counts_from_the_record_that_says_so() {
    let joining = Part { membership: Membership::Joining, ..active(0, None) };
    let mut agreement = among(&[(2, joining)]);
    assert_eq!(agreement.clone().step(Event::Free), Some(Progress::Advanced));
    agreement.step(Event::Heard(id(2), active(0, None)));
    assert_eq!(agreement.step(Event::Free), None);
}

#[test]
fn a_restart_begins_again() {
    let mut agreement = among(&[(2, active(0, Some(0)))]);
    agreement.step(Event::Heard(id(2), active(0, None)));
    assert_eq!(agreement.step(Event::Free), None);
}

/// Vehicle 1 at the first step, after it has heard these registers and sees these others.
fn after(others: &[(u8, Part)], event: Event) -> (One, Option<Progress>) {
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
    let mut agreement = One::new(2, Partition::Quorum);
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

/// Few steps, so that they collide. A step reached is one that was entered.
fn part() -> impl Strategy<Value = Part> {
    let step_and_reached = (0..=LAST_STEP).prop_flat_map(|step| (Just(step), proptest::option::of(0..=step)));
    let step_vouched_and_reached =
        step_and_reached.prop_flat_map(|(step, reached)| (Just(step), 0..=step, Just(reached)));
    (membership(), step_vouched_and_reached).prop_map(|(membership, (step, vouched, reached))| Part {
        membership,
        step,
        vouched,
        reached,
    })
}

fn vehicle() -> impl Strategy<Value = VehicleId> {
    (2..=ROSTER).prop_map(id)
}

fn event() -> impl Strategy<Value = Event> {
    prop_oneof![
        4 => (vehicle(), part()).prop_map(|(id, part)| Event::Heard(id, part)),
        4 => Just(Event::Reached),
        4 => Just(Event::Free),
        2 => (vec(vehicle(), 0..4), any::<bool>()).prop_map(|(heard, misses_any)| {
            Event::Sees { heard: heard.into_iter().collect(), misses_any }
        }),
        1 => (0..=LAST_STEP + 1).prop_map(Event::Ordered),
        1 => membership().prop_map(Event::Became),
    ]
}

fn policy() -> impl Strategy<Value = Partition> {
    select(&[Partition::Continue, Partition::Quorum])
}

proptest! {
    #[test]
    fn neither_step_nor_reached_ever_goes_back(partition in policy(), events in vec(event(), 0..60)) {
        let mut agreement = One::new(ROSTER, partition);
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
        let mut agreement = there(partition);
        for event in events {
            let own = agreement.agreement.own();
            let members: Vec<Part> =
                agreement.others().parts.filter(|part| part.membership == Membership::Active).collect();
            let progress = agreement.step(event);
            if event != Event::Free {
                prop_assert_ne!(progress, Some(Progress::Advanced));
                continue;
            }
            let is_enough = partition == Partition::Continue || members.len() + 1 > usize::from(ROSTER) / 2;
            let is_ready =
                own.membership == Membership::Active && own.reached == Some(own.step) && own.step < LAST_STEP;
            let is_there = |part: &Part| part.step > own.step || part.reached >= Some(own.step);
            let may = is_ready && is_enough && members.iter().all(is_there);
            prop_assert_eq!(progress, may.then_some(Progress::Advanced));
            prop_assert_eq!(agreement.at(), own.step + u32::from(may));
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
