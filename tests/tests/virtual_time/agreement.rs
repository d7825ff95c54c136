//! Model check of the mission agreement: all states that three agents can reach by delivery in any order, loss,
//! repetition, an outage and a return, a network cut and its end.
//!
//! The model runs the agreement code that flies. Around it the model has only what the agents cannot know: which messages
//! are in flight, which agents are up, which links are cut. An agent sends its agreement state whenever it changes. A
//! message stays in flight for ever and may arrive at any time, any number of times, or never: this covers loss,
//! repetition, delay and reordering at once. The model has no time, and leaves out reaching the last step, which no
//! agent ever leaves.
#![expect(clippy::disallowed_methods, reason = "the search is timed")]

mod agent;
mod swarm;

use std::time::Instant;

use skein_common::scenario::Partition;
use stateright::{Checker, HasDiscoveries, Model, Property};
use swarm::{Action, Bounds, Swarm};

const RULE_B: &str = "rule (b): no agent is behind a step that two of the peers in contact vouch for";
const P1: &str = "P1: neither step nor reached nor vouched decreases in one incarnation";
const P2: &str = "P2: an agent that advances has received from every peer in view that it reached the step";
const P3: &str = "P3: no agent passes a step before all settled agents reached it";
const P3_SKEW: &str = "P3: no agent is two steps ahead of a settled agent";
const P4: &str = "P4: no step begins before an agent reached the one before";
const P5: &str = "P5: a fair schedule completes from here";
const P8: &str = "P8: whichever one agent makes no progress, the others complete from here";
const P7: &str = "P7: the two sides of a cut never both advance without the other";
const VOUCHED: &str = "no agent vouches for a step that no honest agent has earned";
const MISLED: &str = "no agent is at a step that no honest agent has earned, unless only the liar is in contact";
const NONE_MISLED: &str = "no agent follows the liar";

impl<const HONEST: usize> Model for Bounds<HONEST> {
    type State = Swarm<HONEST>;
    type Action = Action;

    fn init_states(&self) -> Vec<Self::State> {
        vec![Swarm::start(self)]
    }

    fn actions(&self, swarm: &Self::State, actions: &mut Vec<Action>) {
        swarm.actions(self, actions);
    }

    fn next_state(&self, swarm: &Self::State, action: Action) -> Option<Self::State> {
        swarm.after(action, self)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        let mut properties = vec![
            Property::always(RULE_B, |_, swarm: &Self::State| !swarm.is_behind()),
            Property::always(P1, |_, swarm: &Self::State| !swarm.breaks(P1)),
            Property::always(P2, |_, swarm: &Self::State| !swarm.breaks(P2)),
            Property::always(P3, |_, swarm: &Self::State| !swarm.breaks(P3)),
            Property::always(P3_SKEW, |_, swarm: &Self::State| !swarm.is_skewed()),
            Property::always(P4, |_, swarm: &Self::State| !swarm.breaks(P4)),
            Property::always(P5, |bounds: &Self, swarm: &Self::State| swarm.clone().completes(bounds)),
            Property::always(P8, |bounds: &Self, swarm: &Self::State| swarm.completes_without_any(bounds)),
            Property::always(VOUCHED, |_, swarm: &Self::State| !swarm.breaks(VOUCHED)),
            Property::always(MISLED, |_, swarm: &Self::State| !swarm.breaks(MISLED)),
            Property::sometimes("all are settled again", |_, swarm: &Self::State| swarm.has_recovered()),
        ];
        // An agent whose only honest peer crashed, or is cut off for a minute, has only the liar in contact.
        let may_be_misled = self.liar && (HONEST == 1 || self.long_cuts || HONEST == 2 && self.outages > 0);
        properties.push(if may_be_misled {
            Property::sometimes("an agent follows the liar", |_, swarm: &Self::State| swarm.is_misled())
        } else {
            Property::always(NONE_MISLED, |_, swarm: &Self::State| !swarm.is_misled())
        });
        match self.partition {
            // The liar counts on both sides of a cut.
            Partition::Quorum if self.liar => {}
            Partition::Quorum => properties.push(Property::always(P7, |_, swarm: &Self::State| !swarm.is_split())),
            Partition::Continue if self.cuts > 0 && HONEST > 1 => {
                let is_split = |_: &Self, swarm: &Self::State| swarm.is_split();
                properties.push(Property::sometimes("both sides of a cut advance", is_split));
            }
            Partition::Continue => {}
        }
        properties
    }
}

/// Searches all states within the bounds.
fn check<const HONEST: usize>(bounds: Bounds<HONEST>) -> impl Checker<Bounds<HONEST>> {
    let begin = Instant::now();
    let checker = bounds.checker().threads(2).spawn_bfs().join();
    let (states, transitions, depth) = (checker.unique_state_count(), checker.state_count(), checker.max_depth());
    println!(
        "{HONEST} honest, {bounds:?}: {states} states, {transitions} transitions, depth {depth}, {:.1?}",
        begin.elapsed()
    );
    checker
}

const POLICIES: [Partition; 2] = [Partition::Continue, Partition::Quorum];

#[test]
fn no_agent_is_left_behind_after_an_outage_of_any_agent() {
    for partition in POLICIES {
        check(Bounds::<3> { outages: 1, ..Bounds::new(2, partition) }).assert_properties();
        check(Bounds::<2> { outages: 1, ..Bounds::new(2, partition) }).assert_properties();
    }
}

#[test]
fn no_agent_is_left_behind_after_a_cut_of_any_agent() {
    for partition in POLICIES {
        check(Bounds::<3> { cuts: 1, ..Bounds::new(2, partition) }).assert_properties();
        check(Bounds::<3> { cuts: 1, long_cuts: true, ..Bounds::new(2, partition) }).assert_properties();
    }
}

#[test]
fn no_agent_of_two_is_left_behind_after_an_outage_and_a_cut() {
    check(Bounds::<2> { outages: 1, cuts: 1, long_cuts: true, ..Bounds::new(2, Partition::Continue) })
        .assert_properties();
}

#[test]
#[ignore = "three million states for each policy: `.ci/long`"]
fn no_agent_of_three_is_left_behind_after_an_outage_and_a_cut() {
    for partition in POLICIES {
        check(Bounds::<3> { outages: 1, cuts: 1, ..Bounds::new(1, partition) }).assert_properties();
    }
}

#[test]
fn a_false_suspicion_can_leave_an_agent_behind_but_stops_none() {
    let bounds = Bounds::<3> { false_suspicion: true, ..Bounds::new(2, Partition::Continue) };
    let checker = check(bounds);
    for property in [RULE_B, P1, P2, P4, P5, VOUCHED, MISLED] {
        checker.assert_no_discovery(property);
    }
    checker.assert_any_discovery(P3_SKEW);
    checker.assert_any_discovery(P3);
    let shortest = bounds.checker().finish_when(HasDiscoveries::AnyOf([P3].into())).spawn_bfs().join();
    println!("{P3}, unless {:?}", shortest.assert_any_discovery(P3).into_actions());
}

/// With two agents no third one can contradict a lie: each believes the other.
#[test]
fn a_liar_can_lead_a_single_peer_forward() {
    let bounds = Bounds::<1> { liar: true, ..Bounds::new(2, Partition::Continue) };
    let checker = check(bounds);
    checker.assert_any_discovery(VOUCHED);
    for property in [RULE_B, P1, P2, P5] {
        checker.assert_no_discovery(property);
    }
}

#[test]
fn a_liar_leads_none_of_two_peers_forward() {
    for partition in POLICIES {
        let liar = Bounds::<2> { liar: true, ..Bounds::new(2, partition) };
        check(Bounds { outages: 1, ..liar }).assert_properties();
        check(Bounds { cuts: 1, ..liar }).assert_properties();
        check(Bounds { cuts: 1, long_cuts: true, ..liar }).assert_properties();
    }
}

#[test]
fn a_liar_leads_none_of_three_peers_forward() {
    for partition in POLICIES {
        check(Bounds::<3> { liar: true, ..Bounds::new(1, partition) }).assert_properties();
    }
}

#[test]
#[ignore = "millions of states: `.ci/long`"]
fn a_liar_leads_none_of_three_peers_forward_after_an_outage_or_a_cut() {
    for partition in POLICIES {
        let liar = Bounds::<3> { liar: true, ..Bounds::new(1, partition) };
        check(Bounds { outages: 1, ..liar }).assert_properties();
        check(Bounds { cuts: 1, ..liar }).assert_properties();
    }
}
