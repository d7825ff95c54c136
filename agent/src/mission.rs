//! What this vehicle does now: join, fly in formation, hold, land.
//!
//! ```text
//!        2 s of listening, rotor at speed              order: land
//!   Joining ------------------------> Active ---------------------------> Left (descends, lands)
//!                                      formation <----> hold (ordered, or nobody is heard)
//! ```
//!
//! Nobody leads. Orders are registers: the larger one wins, every agent repeats the largest that it knows of, so an order
//! that reaches one vehicle reaches all.

use nalgebra::Vector2;
use skein_common::id::VehicleId;
use skein_common::message::{Happening, Mission as MissionMessage, Order, Verb};
use skein_common::state::{Activity, Membership};
use skein_common::time::{LocalTime, Now, PlantTime};

use crate::estimate::Estimate;

/// An agent listens for this long before it takes part, s.
pub const JOIN_S: f64 = 2.0;
/// Above this height of the centre of gravity a vehicle flies, m.
const FLYING_ABOVE_M: f64 = 1.5;
/// At altitude: this close to it, m.
const ALTITUDE_REACHED_M: f64 = 1.0;
/// Descent to land, m/s, and the gentler one below [`GENTLE_BELOW_M`].
const DESCENT_M_S: f64 = 2.0;
const GENTLE_DESCENT_M_S: f64 = 0.7;
const GENTLE_BELOW_M: f64 = 6.0;
/// The altitude asked for runs at most this far below the vehicle: an error that holds the wanted sink rate, m.
const DESCENT_LEAD_M: f64 = 3.0;
/// Below this height and for [`TOUCHDOWN_S`] not sinking: down, m, m/s, s.
const TOUCHDOWN_BELOW_M: f64 = 3.0;
const TOUCHDOWN_SINK_M_S: f64 = 0.15;
const TOUCHDOWN_S: f64 = 1.0;
/// The rotor is unloaded within this time after touchdown, s.
const UNLOAD_S: f64 = 2.0;

/// What the formation stage is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Task {
    /// Nothing: leave the controls alone.
    Wait,
    /// Fly the formation law.
    Formation {
        /// Centre of the formation, north and east, m.
        centre_ne_m: Vector2<f64>,
        /// Above the origin, m.
        altitude_m: f64,
        /// Clockwise from north.
        heading_rad: f64,
    },
    /// Go to this place and stay.
    Stay {
        /// North and east, m.
        at_ne_m: Vector2<f64>,
        /// Above the origin, m; sinks during a landing.
        altitude_m: f64,
        /// Clockwise from north.
        heading_rad: f64,
    },
    /// Down: take the collective out and keep everything else neutral.
    Park,
}

/// Where the formation is to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Centre, north and east, m.
    pub centre_ne_m: Vector2<f64>,
    /// Above the origin, m.
    pub altitude_m: f64,
}

/// The mission stage of one vehicle.
#[derive(Clone, Debug)]
pub struct Mission {
    goal: Goal,
    plan: u64,
    /// Nobody takes off with a slower rotor, rad/s.
    take_off_rotor_rad_s: Option<f64>,
    /// Peers already told of for flying another plan.
    strangers: Vec<VehicleId>,
    /// Since when this life has listened.
    since: Option<LocalTime>,
    membership: Membership,
    activity: Activity,
    order: Option<Order>,
    leaving: bool,
    heading_rad: f64,
    at_altitude: bool,
    /// Where to stay, once that has begun.
    stay: Option<Place>,
    landing: Option<Landing>,
}

#[derive(Clone, Copy, Debug)]
struct Place {
    at_ne_m: Vector2<f64>,
    altitude_m: f64,
}

#[derive(Clone, Copy, Debug)]
struct Landing {
    last: PlantTime,
    /// How long the vehicle has not been sinking near the ground, s.
    resting_s: f64,
    /// How long the rotor has been unloaded, s.
    unloading_s: Option<f64>,
}

impl Mission {
    /// A mission not yet begun; `plan` is the hash of the plan it is part of. Before the rotor has reached
    /// `take_off_rotor_rad_s` the vehicle does not take part, if the plant tells the rotor's speed.
    pub fn new(goal: Goal, plan: u64, take_off_rotor_rad_s: Option<f64>) -> Self {
        Self {
            goal,
            plan,
            take_off_rotor_rad_s,
            strangers: Vec::new(),
            since: None,
            membership: Membership::Joining,
            activity: Activity::Joining,
            order: None,
            leaving: false,
            heading_rad: 0.0,
            at_altitude: false,
            stay: None,
            landing: None,
        }
    }

    /// Merges an order: the larger register stands. True if it is news.
    pub fn merge(&mut self, order: Order) -> bool {
        let news = self.order < Some(order);
        if news {
            self.order = Some(order);
        }
        news
    }

    /// This vehicle lands and leaves, whatever the others do.
    pub fn leave(&mut self) {
        self.leaving = true;
    }

    /// Takes up a peer's register: its order, if it flies the same plan. Gives what is worth telling.
    pub fn listen(&mut self, said: &MissionMessage) -> Option<Happening> {
        if said.plan == self.plan {
            return said.order.filter(|&order| self.merge(order)).map(Happening::OrderTaken);
        }
        let stranger = said.header.sender;
        let news = !self.strangers.contains(&stranger);
        if news {
            self.strangers.push(stranger);
        }
        news.then_some(Happening::PlanDiffers(stranger))
    }

    /// What to do now. `alone` says that there were others and that nobody is heard any more.
    pub fn step(&mut self, now: Now, estimate: &Estimate, alone: bool) -> Task {
        let since = *self.since.get_or_insert_with(|| {
            self.heading_rad = estimate.attitude.heading_rad;
            now.local
        });
        let has_listened = now.local.seconds_since(since) >= JOIN_S;
        if self.membership == Membership::Joining && has_listened && self.is_rotor_ready(estimate) {
            self.membership = Membership::Active;
        }
        match (self.membership, self.order.map(|order| order.verb)) {
            (Membership::Joining, _) => self.join(estimate),
            (_, Some(Verb::Land)) => self.land(now, estimate),
            // Whoever is on the way down stays on it.
            _ if self.leaving || self.landing.is_some() => self.land(now, estimate),
            (_, Some(Verb::Hold)) => self.hold(estimate),
            _ if alone => self.hold(estimate),
            _ => self.fly(estimate),
        }
    }

    /// Hash of the plan.
    pub fn plan(&self) -> u64 {
        self.plan
    }

    /// Whether the others may count on this vehicle.
    pub fn membership(&self) -> Membership {
        self.membership
    }

    /// What the vehicle is doing.
    pub fn activity(&self) -> Activity {
        self.activity
    }

    /// The newest order known.
    pub fn order(&self) -> Option<Order> {
        self.order
    }

    fn is_rotor_ready(&self, estimate: &Estimate) -> bool {
        let speeds = estimate.rotor_speed_rad_s.zip(self.take_off_rotor_rad_s);
        speeds.is_none_or(|(speed_rad_s, least_rad_s)| speed_rad_s >= least_rad_s)
    }

    /// Joining on the ground leaves the controls alone; joining in the air (after a restart) stays in place.
    fn join(&mut self, estimate: &Estimate) -> Task {
        if estimate.height_m > FLYING_ABOVE_M {
            self.stay(estimate, Activity::Joining)
        } else {
            self.activity = Activity::Joining;
            Task::Wait
        }
    }

    fn fly(&mut self, estimate: &Estimate) -> Task {
        let Goal { centre_ne_m, altitude_m } = self.goal;
        self.stay = None;
        self.at_altitude |= (estimate.position.altitude_m() - altitude_m).abs() < ALTITUDE_REACHED_M;
        self.activity = if self.at_altitude { Activity::Formation } else { Activity::TakingOff };
        Task::Formation { centre_ne_m, altitude_m, heading_rad: self.heading_rad }
    }

    /// On the ground there is nothing to hold.
    fn hold(&mut self, estimate: &Estimate) -> Task {
        if estimate.height_m < FLYING_ABOVE_M && !self.at_altitude && self.stay.is_none() {
            self.activity = Activity::Holding;
            return Task::Wait;
        }
        self.stay(estimate, Activity::Holding)
    }

    fn stay(&mut self, estimate: &Estimate, activity: Activity) -> Task {
        self.activity = activity;
        let Place { at_ne_m, altitude_m } = *self.place(estimate);
        Task::Stay { at_ne_m, altitude_m, heading_rad: self.heading_rad }
    }

    /// The place to stay at: where the vehicle was when staying began.
    fn place(&mut self, estimate: &Estimate) -> &mut Place {
        self.stay.get_or_insert_with(|| Place {
            at_ne_m: estimate.position.horizontal(),
            altitude_m: estimate.position.altitude_m(),
        })
    }

    fn land(&mut self, now: Now, estimate: &Estimate) -> Task {
        self.membership = Membership::Left;
        let mut landing = self.landing.unwrap_or(Landing { last: now.plant, resting_s: 0.0, unloading_s: None });
        let dt_s = now.plant.seconds_since(landing.last).max(0.0);
        landing.last = now.plant;
        let resting = estimate.height_m < TOUCHDOWN_BELOW_M && estimate.velocity.down_m_s().abs() < TOUCHDOWN_SINK_M_S;
        landing.resting_s = if resting { landing.resting_s + dt_s } else { 0.0 };
        if landing.resting_s > TOUCHDOWN_S || self.activity == Activity::Joining {
            landing.unloading_s.get_or_insert(0.0);
        }
        if let Some(unloading_s) = &mut landing.unloading_s {
            *unloading_s += dt_s;
            self.activity = if *unloading_s > UNLOAD_S { Activity::Landed } else { Activity::Landing };
            self.landing = Some(landing);
            return Task::Park;
        }
        self.landing = Some(landing);

        let sink_m_s = if estimate.height_m > GENTLE_BELOW_M { DESCENT_M_S } else { GENTLE_DESCENT_M_S };
        let lowest_m = estimate.position.altitude_m() - DESCENT_LEAD_M;
        let place = self.place(estimate);
        place.altitude_m = (place.altitude_m - sink_m_s * dt_s).max(lowest_m);
        self.stay(estimate, Activity::Landing)
    }
}

#[cfg(test)]
mod tests;
