//! The mission agreement in every order in which things can happen: all states that three agents can come to by delivery
//! in any order, loss, repetition, a fall and a return, a cut and its heal.
//!
//! The model holds the agents' own agreements, the very code that flies, and around them only what they cannot know:
//! which words are under way, who is up, which links are cut. An agent says its part whenever that changes. A word that
//! was ever said stays under way for good and may arrive at any time, any number of times, or never: that is loss,
//! repetition, delay and reordering at once. Time is left out, and so is reaching the last step, which nobody leaves.
#![expect(
    clippy::unwrap_used,
    clippy::disallowed_methods,
    reason = "what a test cannot do has failed; the search is timed"
)]

mod swarm;

use std::time::Instant;

use skein_common::scenario::Partition;
use stateright::{Checker, HasDiscoveries, Model, Property};
use swarm::{Action, Bounds, Swarm};

const RULE_2: &str = "rule 2: nobody is behind a step that it has heard of";
const P1: &str = "P1: neither step nor reached goes back in one life";
const P2: &str = "P2: whoever advances has heard from everybody in view that they were there";
const P3: &str = "P3: nobody passes a step before all settled agents reached it";
const P3_SKEW: &str = "P3: nobody is two steps ahead of a settled agent";
const P4: &str = "P4: no step begins before somebody reached the one before";
const P5: &str = "P5: a fair schedule completes from here";
const P7: &str = "P7: the two sides of a cut never both advance without the other";

impl Model for Bounds {
    type State = Swarm;
    type Action = Action;

    fn init_states(&self) -> Vec<Swarm> {
        vec![Swarm::start(self)]
    }

    fn actions(&self, swarm: &Swarm, actions: &mut Vec<Action>) {
        swarm.actions(self, actions);
    }

    fn next_state(&self, swarm: &Swarm, action: Action) -> Option<Swarm> {
        swarm.after(action, self)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        let mut properties = vec![
            Property::always(RULE_2, |_, swarm: &Swarm| !swarm.is_behind()),
            Property::always(P1, |_, swarm: &Swarm| !swarm.breaks(P1)),
            Property::always(P2, |_, swarm: &Swarm| !swarm.breaks(P2)),
            Property::always(P3, |_, swarm: &Swarm| !swarm.breaks(P3)),
            Property::always(P3_SKEW, |_, swarm: &Swarm| !swarm.is_skewed()),
            Property::always(P4, |_, swarm: &Swarm| !swarm.breaks(P4)),
            Property::always(P5, |bounds: &Self, swarm: &Swarm| swarm.clone().completes(bounds.last_step)),
            Property::sometimes("all are settled again", |_, swarm: &Swarm| swarm.has_recovered()),
        ];
        match self.partition {
            Partition::Quorum => properties.push(Property::always(P7, |_, swarm: &Swarm| !swarm.is_split())),
            Partition::Continue if self.cuts > 0 => {
                properties.push(Property::sometimes("both sides of a cut go on", |_, swarm: &Swarm| swarm.is_split()));
            }
            Partition::Continue => {}
        }
        properties
    }
}

/// Searches all states within the bounds.
fn check(bounds: Bounds) -> impl Checker<Bounds> {
    let begin = Instant::now();
    let checker = bounds.checker().threads(2).spawn_bfs().join();
    let (states, transitions, depth) = (checker.unique_state_count(), checker.state_count(), checker.max_depth());
    println!("{bounds:?}: {states} states, {transitions} transitions, depth {depth}, {:.1?}", begin.elapsed());
    checker
}

const POLICIES: [Partition; 2] = [Partition::Continue, Partition::Quorum];

#[test]
fn nobody_is_left_behind_whoever_falls_and_comes_back() {
    for partition in POLICIES {
        check(Bounds { last_step: 2, partition, falls: 1, cuts: 0, false_suspicion: false }).assert_properties();
    }
}

#[test]
fn nobody_is_left_behind_whoever_is_cut_off_for_a_while() {
    for partition in POLICIES {
        check(Bounds { last_step: 2, partition, falls: 0, cuts: 1, false_suspicion: false }).assert_properties();
    }
}

#[test]
fn nobody_is_left_behind_by_a_fall_and_a_cut_together() {
    for partition in POLICIES {
        check(Bounds { last_step: 1, partition, falls: 1, cuts: 1, false_suspicion: false }).assert_properties();
    }
}

#[test]
fn a_false_suspicion_leaves_somebody_behind_but_stops_nobody() {
    let bounds = Bounds { last_step: 2, partition: Partition::Continue, falls: 0, cuts: 0, false_suspicion: true };
    let checker = check(bounds);
    for property in [RULE_2, P1, P2, P4, P5] {
        checker.assert_no_discovery(property);
    }
    checker.assert_any_discovery(P3_SKEW);
    checker.assert_any_discovery(P3);
    let shortest = bounds.checker().finish_when(HasDiscoveries::AnyOf([P3].into())).spawn_bfs().join();
    println!("{P3}, unless {:?}", shortest.assert_any_discovery(P3).into_actions());
}
