use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::select;

use skein_common::id::{VehicleId, VehicleSet};

use super::*;
use crate::tests::id;

const ROSTER: u8 = 4;
const LAST_STEP: u32 = 3;

fn set(numbers: &[u8]) -> VehicleSet {
    numbers.iter().map(|&number| id(number)).collect()
}

fn active(step: u32, reached: Option<u32>) -> AgreementState {
    AgreementState { membership: Membership::Active, step, vouched: step, reached }
}

/// An event at vehicle 1.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Event {
    /// A newer agreement state of another vehicle.
    Received(VehicleId, AgreementState),
    Reached,
    Ordered(u32),
    Became(Membership),
    Contact {
        received: VehicleSet,
        absent_may_fly: bool,
    },
    Free,
}

/// These others are in contact. Those of the four that are not may be flying.
fn in_contact(numbers: &[u8]) -> Event {
    Event::Contact { received: set(numbers), absent_may_fly: numbers.len() + 1 < usize::from(ROSTER) }
}

/// These others are in contact, and all further ones have left or were silent for long.
fn only_in_contact(numbers: &[u8]) -> Event {
    Event::Contact { received: set(numbers), absent_may_fly: false }
}

/// Vehicle 1's agreement, with the inputs from its other stages.
#[derive(Clone, Debug)]
struct One {
    agreement: Agreement,
    /// The newest agreement state of each of the others.
    states: Vec<(VehicleId, AgreementState)>,
    received: VehicleSet,
    absent_may_fly: bool,
}

impl One {
    fn new(roster: u8, partition: Partition) -> Self {
        let (agreement, received) = (Agreement::new(roster, LAST_STEP, partition), VehicleSet::default());
        Self { agreement, states: Vec::new(), received, absent_may_fly: true }
    }

    fn step(&mut self, event: Event) -> Option<Progress> {
        let mut agreement = self.agreement.clone();
        let mut progress = None;
        match event {
            Event::Received(id, part) => {
                self.states.retain(|(known, _)| *known != id);
                self.states.push((id, part));
            }
            Event::Reached => agreement.reach(),
            Event::Ordered(step) => progress = agreement.order(step),
            Event::Became(membership) => agreement.set_membership(membership),
            Event::Contact { received, absent_may_fly } => {
                (self.received, self.absent_may_fly) = (received, absent_may_fly);
                progress = agreement.follow(&self.others());
            }
            Event::Free => progress = agreement.advance(&self.others()),
        }
        self.agreement = agreement;
        progress
    }

    fn others(&self) -> OtherStates<impl Iterator<Item = AgreementState> + Clone> {
        let in_contact = self.states.iter().filter(|(id, _)| self.received.contains(*id));
        OtherStates { states: in_contact.map(|(_, part)| *part), absent_may_fly: self.absent_may_fly }
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
fn at_reached_step(partition: Partition) -> One {
    let mut one = One::new(ROSTER, partition);
    one.step(Event::Became(Membership::Active));
    one.step(Event::Reached);
    one
}

/// The same in contact with these others.
fn at_reached_step_with(others: &[(u8, AgreementState)]) -> One {
    let mut one = at_reached_step(Partition::Continue);
    for &(number, part) in others {
        one.step(Event::Received(id(number), part));
    }
    one.step(in_contact(&others.iter().map(|(number, _)| *number).collect::<Vec<_>>()));
    one
}

#[test]
fn a_step_is_left_when_the_last_member_reaches_it() {
    let mut agreement = at_reached_step_with(&[(2, active(0, Some(0))), (3, active(0, None))]);
    assert_eq!(agreement.step(Event::Free), None);
    assert_eq!(agreement.step(Event::Received(id(3), active(0, Some(0)))), None);
    assert_eq!(agreement.step(Event::Free), Some(Progress::Advanced));
    assert_eq!((agreement.at(), agreement.reached()), (1, Some(0)));
    assert_eq!(agreement.step(Event::Free), None, "the next step has to be reached first");
}

#[test]
fn a_vehicle_that_has_not_reached_the_step_stays_although_all_others_have() {
    let mut agreement = One::new(ROSTER, Partition::Continue);
    agreement.step(Event::Became(Membership::Active));
    agreement.step(Event::Received(id(2), active(0, Some(0))));
    agreement.step(in_contact(&[2]));
    assert_eq!(agreement.step(Event::Free), None);
}

#[test]
fn no_vehicle_waits_for_one_that_joins_has_left_or_is_not_in_contact() {
    for membership in [Membership::Joining, Membership::Left] {
        let mut agreement = at_reached_step_with(&[(2, AgreementState { membership, ..active(0, None) })]);
        assert_eq!(agreement.step(Event::Free), Some(Progress::Advanced), "{membership:?}");
    }
    let mut agreement = at_reached_step_with(&[(2, active(0, None))]);
    assert_eq!(agreement.step(Event::Free), None);
    agreement.step(in_contact(&[]));
    assert_eq!(agreement.step(Event::Free), Some(Progress::Advanced));
}

#[test]
fn a_vehicle_past_a_step_counts_as_having_reached_it() {
    let carried = active(2, Some(0));
    assert!(carried.has_reached(0) && carried.has_reached(1) && !carried.has_reached(2));
    assert!(active(2, Some(2)).has_reached(2));
}

#[test]
fn a_joining_vehicle_follows_two_others_but_does_not_advance_itself() {
    let mut agreement = One::new(ROSTER, Partition::Continue);
    agreement.step(Event::Reached);
    assert_eq!(agreement.step(Event::Free), None);
    agreement.step(Event::Received(id(2), active(2, Some(1))));
    agreement.step(Event::Received(id(3), active(2, None)));
    assert_eq!(agreement.step(in_contact(&[2, 3])), Some(Progress::Carried { from: 0, reached: true }));
    assert_eq!((agreement.at(), agreement.membership()), (2, Membership::Joining));
}

#[test]
fn a_member_counts_from_the_state_that_reports_it_active() {
    let joining = AgreementState { membership: Membership::Joining, ..active(0, None) };
    let mut agreement = at_reached_step_with(&[(2, joining)]);
    assert_eq!(agreement.clone().step(Event::Free), Some(Progress::Advanced));
    agreement.step(Event::Received(id(2), active(0, None)));
    assert_eq!(agreement.step(Event::Free), None);
}

#[test]
fn a_restarted_agent_begins_at_the_first_step() {
    let mut agreement = at_reached_step_with(&[(2, active(0, Some(0)))]);
    agreement.step(Event::Received(id(2), active(0, None)));
    assert_eq!(agreement.step(Event::Free), None);
}

/// Vehicle 1 at the first step, after these agreement states and this event.
fn after(others: &[(u8, AgreementState)], event: Event) -> (One, Option<Progress>) {
    let mut agreement = at_reached_step(Partition::Continue);
    for &(number, part) in others {
        assert_eq!(agreement.step(Event::Received(id(number), part)), None);
    }
    let progress = agreement.step(event);
    (agreement, progress)
}

#[test]
fn one_later_state_moves_no_vehicle_and_two_move_it_to_the_step_of_both() {
    let (mut agreement, progress) = after(&[(2, active(3, Some(3))), (3, active(0, None))], in_contact(&[2, 3]));
    assert_eq!((progress, agreement.at(), agreement.vouched()), (None, 0, 0), "one of the two may be false");
    agreement.step(Event::Received(id(3), active(1, None)));
    assert_eq!(agreement.step(in_contact(&[2, 3])), Some(Progress::Carried { from: 0, reached: true }));
    assert_eq!((agreement.at(), agreement.vouched(), agreement.reached()), (1, 1, Some(0)));
    agreement.step(Event::Received(id(4), active(2, None)));
    assert_eq!(agreement.step(in_contact(&[2, 3, 4])), Some(Progress::Carried { from: 1, reached: false }));
    assert_eq!(agreement.at(), 2, "two are at step 2 or later");
}

#[test]
fn a_vehicle_out_of_contact_vouches_for_nothing() {
    let ahead = [(2, active(3, Some(3))), (3, active(3, Some(3)))];
    assert_eq!(after(&ahead, in_contact(&[2])).1, None);
    assert!(after(&ahead, in_contact(&[2, 3])).1.is_some());
}

#[test]
fn a_single_state_moves_a_vehicle_only_if_no_further_one_may_fly() {
    let ahead = [(2, active(3, Some(2)))];
    assert_eq!(after(&ahead, in_contact(&[2])).1, None);
    let (mut agreement, progress) = after(&ahead, only_in_contact(&[2]));
    assert_eq!(progress, Some(Progress::Carried { from: 0, reached: true }));
    assert_eq!((agreement.at(), agreement.vouched()), (3, 0), "only one vehicle has vouched for it");
    agreement.step(Event::Received(id(3), active(3, None)));
    agreement.step(in_contact(&[2, 3]));
    assert_eq!(agreement.vouched(), 3, "two vouch for it now");
}

#[test]
fn a_vehicle_moved_by_a_single_state_moves_no_further_vehicle() {
    let misled = AgreementState { vouched: 0, ..active(3, None) };
    let (agreement, progress) = after(&[(2, active(3, None)), (3, misled)], in_contact(&[2, 3]));
    assert_eq!((progress, agreement.at()), (None, 0));
    assert_eq!(after(&[(3, misled)], only_in_contact(&[3])).1, None);
    // Nor do the steps it reaches after that.
    let (mut agreement, _) = after(&[(2, active(2, None))], only_in_contact(&[2]));
    agreement.step(Event::Reached);
    agreement.step(Event::Received(id(2), active(3, None)));
    assert_eq!(agreement.step(Event::Free), Some(Progress::Advanced));
    assert_eq!((agreement.at(), agreement.vouched()), (3, 0));
}

#[test]
fn in_a_swarm_of_two_each_follows_the_other() {
    let mut agreement = One::new(2, Partition::Quorum);
    agreement.step(Event::Received(id(2), active(2, None)));
    assert!(agreement.step(only_in_contact(&[2])).is_some());
    assert_eq!((agreement.at(), agreement.vouched()), (2, 2));
}

#[test]
fn a_vehicle_that_ran_ahead_alone_waits_for_the_others_to_follow() {
    let mut others = after(&[(2, active(2, None)), (3, active(0, Some(0)))], in_contact(&[2, 3])).0;
    assert_eq!(others.step(Event::Free), Some(Progress::Advanced), "it does not keep a vehicle from its own step");
    others.step(Event::Reached);
    others.step(Event::Received(id(3), active(1, Some(1))));
    assert_eq!(others.step(Event::Free), Some(Progress::Advanced));
    let mut ahead = after(&[(2, active(0, None))], in_contact(&[2])).0;
    ahead.step(Event::Ordered(2));
    ahead.step(Event::Reached);
    assert_eq!(ahead.step(Event::Free), None);
    ahead.step(Event::Received(id(2), active(2, Some(2))));
    assert_eq!(ahead.step(Event::Free), Some(Progress::Advanced));
}

#[test]
fn an_order_moves_forward_but_never_back_or_past_the_last_step() {
    let mut agreement = at_reached_step(Partition::Continue);
    assert_eq!(agreement.step(Event::Ordered(2)), Some(Progress::Carried { from: 0, reached: true }));
    assert_eq!(agreement.step(Event::Ordered(1)), None);
    assert_eq!(agreement.at(), 2);
    agreement.step(Event::Ordered(u32::MAX));
    assert_eq!(agreement.at(), LAST_STEP);
}

#[test]
fn the_last_step_is_never_left() {
    let mut agreement = at_reached_step(Partition::Continue);
    agreement.step(Event::Ordered(LAST_STEP));
    agreement.step(Event::Reached);
    assert_eq!((agreement.reached(), agreement.step(Event::Free)), (Some(LAST_STEP), None));
}

#[test]
fn under_quorum_half_of_the_roster_cannot_advance() {
    for (others, enough) in [(&[][..], false), (&[2][..], false), (&[2, 3][..], true), (&[2, 3, 4][..], true)] {
        for (partition, advances) in [(Partition::Quorum, enough), (Partition::Continue, true)] {
            let mut agreement = at_reached_step(partition);
            for number in 2..=ROSTER {
                agreement.step(Event::Received(id(number), active(0, Some(0))));
            }
            agreement.step(in_contact(others));
            assert_eq!(agreement.has_quorum(), advances, "{partition:?} with {others:?}");
            assert_eq!(agreement.step(Event::Free).is_some(), advances, "{partition:?} with {others:?}");
        }
    }
}

fn membership() -> impl Strategy<Value = Membership> {
    select(&[Membership::Joining, Membership::Active, Membership::Active, Membership::Active, Membership::Left])
}

/// Few steps, so that they coincide. A reached step is one that was entered.
fn part() -> impl Strategy<Value = AgreementState> {
    let step_and_reached = (0..=LAST_STEP).prop_flat_map(|step| (Just(step), proptest::option::of(0..=step)));
    let step_vouched_and_reached =
        step_and_reached.prop_flat_map(|(step, reached)| (Just(step), 0..=step, Just(reached)));
    (membership(), step_vouched_and_reached).prop_map(|(membership, (step, vouched, reached))| AgreementState {
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
        4 => (vehicle(), part()).prop_map(|(id, part)| Event::Received(id, part)),
        4 => Just(Event::Reached),
        4 => Just(Event::Free),
        2 => (vec(vehicle(), 0..4), any::<bool>()).prop_map(|(received, absent_may_fly)| {
            Event::Contact { received: received.into_iter().collect(), absent_may_fly }
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
    fn step_and_reached_never_go_back(partition in policy(), events in vec(event(), 0..60)) {
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
    fn an_agent_advances_exactly_when_all_active_members_report_the_step_reached(
        partition in policy(), events in vec(event(), 0..60),
    ) {
        let mut agreement = at_reached_step(partition);
        for event in events {
            let own = agreement.agreement.own();
            let members: Vec<AgreementState> =
                agreement.others().states.filter(|part| part.membership == Membership::Active).collect();
            let progress = agreement.step(event);
            if event != Event::Free {
                prop_assert_ne!(progress, Some(Progress::Advanced));
                continue;
            }
            let is_enough = partition == Partition::Continue || members.len() + 1 > usize::from(ROSTER) / 2;
            let is_ready =
                own.membership == Membership::Active && own.reached == Some(own.step) && own.step < LAST_STEP;
            let is_there = |part: &AgreementState| part.step > own.step || part.reached >= Some(own.step);
            let may = is_ready && is_enough && members.iter().all(is_there);
            prop_assert_eq!(progress, may.then_some(Progress::Advanced));
            prop_assert_eq!(agreement.at(), own.step + u32::from(may));
        }
    }

    #[test]
    fn no_state_of_one_vehicle_moves_another_in_contact_with_a_third(
        lies in vec(part(), 1..8), honest in part(), absent_may_fly: bool,
    ) {
        let honest = AgreementState { step: 0, vouched: 0, ..honest };
        let mut agreement = at_reached_step(Partition::Continue);
        agreement.step(Event::Received(id(2), honest));
        for lie in lies {
            agreement.step(Event::Received(id(3), lie));
            agreement.step(Event::Contact { received: set(&[2, 3]), absent_may_fly });
            prop_assert_eq!((agreement.at(), agreement.vouched()), (0, 0));
        }
    }
}
