//! Model check of what two teams do that want the same place: three teams, every order in which they complete their steps,
//! for every pair of places that each may visit one after the other.
//!
//! The model runs the decision that flies, [`Waiting::waits_for`]. A tick is half of the time for which a place must have
//! been free; a message takes up to one tick, so that each team decides by what the others sent in the tick before. A team
//! completes its step at any time, or never: then the others need not reach their last place. A team that has completed its
//! last step lands, and occupies nothing from then on.

use skein_common::frame::PositionNed;
use skein_common::id::TeamId;
use skein_core::intent::{Area, Intent, WAIT_LIMIT_S, Waiting};
use stateright::{Checker, HasDiscoveries, Model, Property};

const TEAMS: usize = 3;
/// Number of ticks for which a place must have been free.
const SETTLED_TICKS: u8 = 2;
/// Number of ticks after which a waiting team no longer waits for a higher number: few, to keep the model small.
const LIMIT_TICKS: u8 = 4;
/// Number of ticks in which a fair schedule ends.
const FAIR_TICKS: usize = 60;

const ONE_ENTERS: &str = "no team enters a place beside one that stays there";
const LOWER_FIRST: &str = "no two teams enter the same place at once";
const COMPLETES: &str = "a fair schedule completes from here";

/// The places that each team visits, one after the other.
type Tours = [Vec<usize>; TEAMS];

/// A team, as far as the others matter to it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
struct Team {
    /// Index of its place in its tour.
    at: usize,
    /// Whether it has completed its step and wants the next place.
    wants: bool,
    /// Whether it has completed its last step and landed.
    landed: bool,
    /// Number of ticks for which it has wanted it, and for which that has been free.
    waited: u8,
    free: u8,
    /// What the others received of it: place, whether it wants the next, and whether it has landed.
    seen: (usize, bool, bool),
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
struct Fleet {
    teams: [Team; TEAMS],
    broken: Option<&'static str>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Action {
    Completes(usize),
    Tick,
}

struct Bounds {
    tours: Tours,
}

impl Bounds {
    /// The place at this index of a team's tour.
    fn place(&self, team: usize, at: usize) -> Area {
        Area { centre: PositionNed::new(1000.0 * self.tours[team][at] as f64, 0.0, -30.0), radius_m: 100.0 }
    }

    fn has_next(&self, team: usize, at: usize) -> bool {
        at + 1 < self.tours[team].len()
    }

    fn tick(&self, before: &Fleet) -> Fleet {
        let mut fleet = *before;
        let mut enter = Vec::new();
        for own in 0..TEAMS {
            let team = &mut fleet.teams[own];
            if !team.wants {
                continue;
            }
            let for_s = if team.waited >= LIMIT_TICKS { WAIT_LIMIT_S + 1.0 } else { f64::from(team.waited) };
            let waiting = Waiting {
                team: number(own),
                occupied: self.place(own, team.at),
                wanted: self.place(own, team.at + 1),
                for_s,
            };
            let waits = (0..TEAMS).filter(|&other| other != own).any(|other| {
                let (at, wants, landed) = before.teams[other].seen;
                let wanted = wants.then(|| self.place(other, at + 1));
                !landed && waiting.waits_for(number(other), &Intent { occupied: self.place(other, at), wanted })
            });
            team.waited = (team.waited + 1).min(LIMIT_TICKS);
            team.free = if waits { 0 } else { team.free + 1 };
            if team.free > SETTLED_TICKS {
                enter.push(own);
            }
        }
        for &own in &enter {
            let next = self.place(own, before.teams[own].at + 1);
            for other in (0..TEAMS).filter(|&other| other != own) {
                let there = before.teams[other];
                let (enters, stays) = (enter.contains(&other), !there.wants && !there.landed);
                if !enters && stays && self.place(other, there.at).meets(&next) {
                    fleet.broken = Some(ONE_ENTERS);
                }
                if enters && self.place(other, there.at + 1).meets(&next) {
                    fleet.broken = Some(LOWER_FIRST);
                }
            }
            fleet.teams[own] = Team { at: before.teams[own].at + 1, seen: fleet.teams[own].seen, ..Team::default() };
        }
        for team in &mut fleet.teams {
            team.seen = (team.at, team.wants, team.landed);
        }
        fleet
    }

    /// Completes the step of a team.
    fn complete(&self, team: &mut Team, own: usize) {
        if self.has_next(own, team.at) { team.wants = true } else { team.landed = true }
    }

    /// Whether all teams come to their last places if each completes its steps.
    fn completes(&self, mut fleet: Fleet) -> bool {
        for _ in 0..FAIR_TICKS {
            (0..TEAMS).for_each(|own| self.complete(&mut fleet.teams[own], own));
            fleet = self.tick(&fleet);
        }
        fleet.teams.iter().all(|team| team.landed)
    }
}

fn number(team: usize) -> TeamId {
    TeamId::first(TEAMS).nth(team).expect("one of the teams")
}

impl Model for Bounds {
    type State = Fleet;
    type Action = Action;

    fn init_states(&self) -> Vec<Fleet> {
        vec![Fleet::default()]
    }

    fn actions(&self, fleet: &Fleet, actions: &mut Vec<Action>) {
        actions.push(Action::Tick);
        let can = |own: &usize| !fleet.teams[*own].wants && !fleet.teams[*own].landed;
        actions.extend((0..TEAMS).filter(can).map(Action::Completes));
    }

    fn next_state(&self, fleet: &Fleet, action: Action) -> Option<Fleet> {
        match action {
            Action::Completes(own) => {
                let mut fleet = *fleet;
                self.complete(&mut fleet.teams[own], own);
                Some(fleet)
            }
            Action::Tick => Some(self.tick(fleet)),
        }
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            Property::always(ONE_ENTERS, |_, fleet: &Fleet| fleet.broken != Some(ONE_ENTERS)),
            Property::always(LOWER_FIRST, |_, fleet: &Fleet| fleet.broken != Some(LOWER_FIRST)),
            Property::always(COMPLETES, |bounds: &Self, fleet: &Fleet| bounds.completes(*fleet)),
        ]
    }
}

/// All tours of three teams that begin at places 0, 1 and 2, visit one of four places, and end at three different ones.
fn all_tours() -> Vec<Tours> {
    let mut all = Vec::new();
    for nth in 0..4_usize.pow(2 * TEAMS as u32) {
        let digit = |place: u32| nth / 4_usize.pow(place) % 4;
        let ends: Vec<usize> = (0..TEAMS as u32).map(|team| digit(TEAMS as u32 + team)).collect();
        if ends[0] != ends[1] && ends[0] != ends[2] && ends[1] != ends[2] {
            all.push([0, 1, 2].map(|team: usize| {
                let mut tour = vec![team, digit(team as u32), ends[team]];
                tour.dedup();
                tour
            }));
        }
    }
    all
}

#[test]
fn teams_that_want_the_same_places_take_turns_and_all_arrive() {
    let (mut states, mut tours_checked) = (0, 0);
    for tours in all_tours() {
        let checker =
            Bounds { tours: tours.clone() }.checker().finish_when(HasDiscoveries::AnyFailures).spawn_bfs().join();
        let found: Vec<_> = checker.discoveries().into_keys().collect();
        assert!(found.is_empty(), "{tours:?}: {:?}", checker.discoveries());
        (states, tours_checked) = (states + checker.unique_state_count(), tours_checked + 1);
    }
    println!("{tours_checked} sets of tours, {states} states");
    assert!(tours_checked > 1000 && states > 100_000, "{tours_checked} {states}");
}
