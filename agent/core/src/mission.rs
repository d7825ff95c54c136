//! What this vehicle does now: join, fly the mission's steps in formation, hold, land.
//!
//! ```text
//!        2 s of listening, rotor at speed        ordered down, last step, something failed
//!   Joining ------------------------> Active ---------------------------> Left (descends, lands)
//!      ^                               | formation <----> hold (ordered, nobody or too few are heard)
//!      +------ own data lost ----------+
//! ```
//!
//! Nobody leads. Which step the swarm is at is agreed on ([`agreement`]), where a moving centre is too ([`centre`]). Orders
//! are registers: the larger one wins, every agent repeats the largest that it knows of, so an order that reaches one
//! vehicle reaches all.

pub mod agreement;
pub mod centre;
pub mod landing;
pub mod plan;
pub mod progress;
pub mod task;

use alloc::vec::Vec;

use nalgebra::Vector2;
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::{self, Failure, Happening, Order, Verb};
use skein_common::scenario::Scenario;
use skein_common::state::{Activity, Membership};
use skein_common::time::{LocalTime, Now, PlantTime};

use crate::control::CollectiveLimit;
use crate::deadlines::Deadline;
use crate::estimate::Estimate;
use crate::failsafe::{Condition, Conditions, Response};
use agreement::{Agreement, Others, Part, Progress};
use landing::{Descent, Landing};
use plan::{Kind, Leg};
use progress::LegProgress;
pub use task::{Goal, Task};

/// Above this height of the centre of gravity a vehicle flies, m.
const FLYING_ABOVE_M: f64 = 1.5;
/// A vehicle off its altitude that comes nearer no faster than this, its collective at its limit, is stuck there after a while
/// ([`Deadline::AltitudeStuck`]), m/s.
const STUCK_M_S: f64 = 0.3;
/// This close to an altitude is at it, m.
pub const AT_ALTITUDE_M: f64 = 1.0;
/// Without auto-trim the collective rules leave an error that grows with the air's speed, 2.4 m at 5 m/s and 7.6 m at
/// 8 m/s: a healthy vehicle may hover this far above what it is asked for, m.
const ABOVE_ALTITUDE_UNTRIMMED_M: f64 = 9.0;

/// What the other stages know that the mission needs.
#[derive(Clone, Copy, Debug, Default)]
pub struct View {
    /// A further vehicle is not heard and may be flying the mission.
    pub misses_any: bool,
    /// What is missing or broken, as far as the stages before the mission know.
    pub conditions: Conditions,
    /// The altitude that was asked for less the vehicle's, m; `None` before one was.
    pub altitude_error_m: Option<f64>,
    /// The end of the controller's authority over the climb, if it is there.
    pub collective_limit: Option<CollectiveLimit>,
    /// Where the formation wants the vehicle, at height and slow.
    pub in_place: bool,
}

/// The mission stage of one vehicle.
#[derive(Clone, Debug)]
pub struct Mission {
    legs: Vec<Leg>,
    plan: u64,
    /// Nobody takes off with a slower rotor, rad/s.
    take_off_rotor_rad_s: Option<f64>,
    /// A healthy vehicle may hover this far above the altitude that it is asked for, m.
    above_altitude_m: f64,
    /// Peers already told of for flying another plan.
    strangers: VehicleSet,
    /// Since when this agent has listened.
    since: Option<LocalTime>,
    activity: Activity,
    agreement: Agreement,
    /// Members at some time of this step that had not reached it when they were last in contact.
    awaited: VehicleSet,
    has_quorum: bool,
    order: Option<Order>,
    leaving: bool,
    heading_rad: f64,
    at_altitude: bool,
    /// How long the vehicle has neither been at its altitude nor come nearer to it, with no collective left, s.
    stuck_s: f64,
    progress: LegProgress,
    /// The step has just begun, and others may be farther along it.
    is_late: bool,
    /// Where to stay, once that has begun.
    stay: Option<Place>,
    landing: Option<Landing>,
}

#[derive(Clone, Copy, Debug)]
struct Place {
    at_ne_m: Vector2<f64>,
    altitude_m: f64,
}

impl Mission {
    /// The mission of a scenario, not yet begun. Before the rotor has reached `take_off_rotor_rad_s` the vehicle does not take
    /// part, if the plant tells the rotor's speed.
    pub fn new(scenario: &Scenario, take_off_rotor_rad_s: Option<f64>) -> Self {
        let legs = plan::legs(&scenario.mission);
        let roster = scenario.swarm.vehicles.min(VehicleId::MAX.into()) as u8;
        let last_step = legs.len().saturating_sub(1).min(message::MAX_STEP as usize) as u32;
        Self {
            legs,
            plan: scenario.plan_hash(),
            take_off_rotor_rad_s,
            above_altitude_m: if scenario.control.auto_trim { 0.0 } else { ABOVE_ALTITUDE_UNTRIMMED_M },
            strangers: VehicleSet::default(),
            since: None,
            activity: Activity::Joining,
            agreement: Agreement::new(roster, last_step, scenario.mission.partition),
            awaited: VehicleSet::default(),
            has_quorum: true,
            order: None,
            leaving: false,
            heading_rad: 0.0,
            at_altitude: false,
            stuck_s: 0.0,
            progress: LegProgress::default(),
            is_late: false,
            stay: None,
            landing: None,
        }
    }

    /// Merges an order: the larger register stands.
    pub fn merge(&mut self, order: Order, happened: &mut Vec<Happening>) {
        if self.order >= Some(order) {
            return;
        }
        self.order = Some(order);
        happened.push(Happening::OrderTaken(Order { seal: None, ..order }));
        if let Verb::Goto(step) = order.verb {
            let progress = self.agreement.order(step);
            self.move_on(progress, core::iter::empty(), happened);
        }
    }

    /// This vehicle lands and leaves, whatever the others do.
    pub fn leave(&mut self) {
        self.leaving = true;
    }

    /// The vehicle knows nothing of itself any more: nobody is to wait for it. It joins anew when it does.
    pub fn withdraw(&mut self) {
        if self.membership() == Membership::Active {
            self.agreement.turn(Membership::Joining);
            self.since = None;
            self.progress.pause();
        }
    }

    /// Takes in a peer's heartbeat: its order, if it flies the same plan.
    pub fn listen(&mut self, heartbeat: &message::Mission, happened: &mut Vec<Happening>) {
        let id = heartbeat.header.sender;
        if heartbeat.plan == self.plan {
            heartbeat.order.into_iter().for_each(|order| self.merge(order, happened));
        } else if !self.strangers.contains(id) {
            self.strangers.insert(id);
            happened.push(Happening::PlanDiffers(id));
        }
    }

    /// What to do now, after the mission has listened to everything received. `heartbeats` are the newest ones of all peers in
    /// contact, which the peers stage keeps: from them come the peers' parts in the agreement, if they fly the same plan, and how
    /// far they take the centre to be.
    pub fn step<'a>(
        &mut self,
        now: Now,
        estimate: &Estimate,
        view: &View,
        heartbeats: impl Iterator<Item = &'a message::Mission> + Clone,
        happened: &mut Vec<Happening>,
    ) -> Task {
        let since = *self.since.get_or_insert_with(|| {
            self.heading_rad = estimate.attitude.heading_rad;
            now.local
        });
        let plan = self.plan;
        let heartbeats = heartbeats.filter(move |heartbeat| heartbeat.plan == plan);
        let others = Others { parts: heartbeats.clone().map(Part::from), misses_any: view.misses_any };
        let progress = self.agreement.follow(&others);
        self.move_on(progress, heartbeats.clone(), happened);
        self.note_awaited(heartbeats.clone());
        self.watch_quorum(self.agreement.has_quorum(&others), happened);
        let has_listened = Deadline::Listened.is_past(now.local.seconds_since(since));
        if core::mem::take(&mut self.is_late) || self.membership() == Membership::Joining {
            self.catch_up(&others, heartbeats.clone());
        }
        if self.membership() == Membership::Joining && has_listened && self.is_rotor_ready(estimate) {
            self.agreement.turn(Membership::Active);
        }
        self.decide(now, estimate, view, heartbeats, happened)
    }

    /// Hash of the plan.
    pub fn plan(&self) -> u64 {
        self.plan
    }

    /// Whether the others may count on this vehicle.
    pub fn membership(&self) -> Membership {
        self.agreement.own().membership
    }

    /// The step that this vehicle is at, counted from 0.
    pub fn at(&self) -> u32 {
        self.agreement.own().step
    }

    /// The latest step that it vouches for.
    pub fn vouched(&self) -> u32 {
        self.agreement.own().vouched
    }

    /// The highest step that it reached in this life.
    pub fn reached(&self) -> Option<u32> {
        self.agreement.own().reached
    }

    /// How far it takes the centre to be along this step's path, m.
    pub fn progress_m(&self) -> f64 {
        self.progress.along_m()
    }

    /// Where it takes the centre to be and how that moves, north and east, m and m/s.
    pub fn centre(&self) -> (Vector2<f64>, Vector2<f64>) {
        self.leg().map(|leg| self.progress.centre(leg)).unwrap_or_default()
    }

    /// Whether the mission has come to its landing.
    pub fn is_at_landing(&self) -> bool {
        self.leg().is_some_and(|leg| leg.kind == Kind::Land)
    }

    /// Whether the vehicle neither is at its altitude nor comes nearer to it, with no collective left.
    pub fn is_stuck(&self) -> bool {
        Deadline::AltitudeStuck.is_past(self.stuck_s)
    }

    /// What the vehicle is doing.
    pub fn activity(&self) -> Activity {
        self.activity
    }

    /// The newest order known.
    pub fn order(&self) -> Option<Order> {
        self.order
    }

    fn leg(&self) -> Option<&Leg> {
        self.legs.get(self.at() as usize)
    }

    fn decide<'a>(
        &mut self,
        now: Now,
        estimate: &Estimate,
        view: &View,
        heartbeats: impl Iterator<Item = &'a message::Mission> + Clone,
        happened: &mut Vec<Happening>,
    ) -> Task {
        let order = self.order.map(|order| order.verb);
        let response = self.conditions(view).response();
        if matches!(response, Response::Land | Response::LandTurning | Response::Autorotate) {
            return self.come_down(now, estimate, response);
        }
        let is_over = self.is_at_landing() && self.membership() != Membership::Joining;
        match (self.membership(), order) {
            (Membership::Joining, _) if !self.leaving => self.join(estimate),
            (_, Some(Verb::Land | Verb::Abort)) => self.land(now, estimate),
            _ if self.leaving || is_over || self.is_down() => self.land(now, estimate),
            (_, Some(Verb::Hold)) => self.hold(estimate),
            _ if response == Response::Hold => self.hold(estimate),
            _ => self.fly(now, estimate, view, heartbeats, happened),
        }
    }

    /// All conditions: those of the stages before, and the mission's own.
    fn conditions(&self, view: &View) -> Conditions {
        let mut conditions = view.conditions;
        conditions.extend(self.is_stuck().then_some(Condition::AltitudeStuck));
        conditions.extend((!self.has_quorum).then_some(Condition::QuorumLost));
        conditions
    }

    /// Begins the step that the agreement has come to, if it has moved on, and tells how it came there.
    fn move_on<'a>(
        &mut self,
        progress: Option<Progress>,
        heartbeats: impl Iterator<Item = &'a message::Mission>,
        happened: &mut Vec<Happening>,
    ) {
        let Some(progress) = progress else { return };
        let to = self.at();
        let without = core::mem::take(&mut self.awaited);
        let told = match progress {
            Progress::Advanced if without.is_empty() => Happening::Advanced(to),
            Progress::Advanced => Happening::ForcedAdvance { to, without },
            Progress::Carried { reached: true, .. } => Happening::Advanced(to),
            Progress::Carried { from, reached: false } => Happening::Skipped { from, to },
        };
        // Whoever has left only looks on.
        happened.extend((self.membership() != Membership::Left).then_some(told));
        self.note_awaited(heartbeats);
        self.progress.begin_next();
        self.is_late = true;
    }

    /// Notes which members have not reached this step. Those out of contact stay as they were.
    fn note_awaited<'a>(&mut self, heartbeats: impl Iterator<Item = &'a message::Mission>) {
        for heartbeat in heartbeats {
            let (id, part) = (heartbeat.header.sender, Part::from(heartbeat));
            if part.is_active() && !part.has_reached(self.at()) {
                self.awaited.insert(id);
            } else {
                self.awaited.remove(id);
            }
        }
    }

    /// A vehicle that comes late takes the centre to be as far as two others have it, so that they hardly wait for it.
    fn catch_up<'a>(
        &mut self,
        others: &Others<impl Iterator<Item = Part> + Clone>,
        heartbeats: impl Iterator<Item = &'a message::Mission>,
    ) {
        let along_m = self.agreement.reliable(others, along_m(heartbeats, self.at()));
        along_m.into_iter().for_each(|along_m| self.progress.catch_up(along_m));
    }

    fn watch_quorum(&mut self, has_quorum: bool, happened: &mut Vec<Happening>) {
        if has_quorum != self.has_quorum && self.membership() == Membership::Active {
            happened.push(if has_quorum { Happening::QuorumBack } else { Happening::QuorumLost });
        }
        self.has_quorum = has_quorum;
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

    /// The step's formation; the next step, when everybody has reached this one.
    fn fly<'a>(
        &mut self,
        now: Now,
        estimate: &Estimate,
        view: &View,
        heartbeats: impl Iterator<Item = &'a message::Mission> + Clone,
        happened: &mut Vec<Happening>,
    ) -> Task {
        self.stay = None;
        if self.landing.take().is_some() {
            // Called back on the way down.
            self.agreement.turn(Membership::Active);
        }
        let is_at_altitude = view.altitude_error_m.is_some_and(|error_m| error_m.abs() < AT_ALTITUDE_M);
        self.at_altitude |= is_at_altitude;
        self.activity = if self.at_altitude { Activity::Formation } else { Activity::TakingOff };
        let is_stuck = !is_at_altitude && Self::is_without_authority(estimate, view);
        self.stuck_s = if is_stuck { self.stuck_s + self.progress.since_s(now.plant) } else { 0.0 };
        happened.extend(self.is_stuck().then_some(Happening::Failed(Failure::Altitude)));
        if self.is_over(now.plant, view.in_place, heartbeats.clone()) && self.reached() < Some(self.at()) {
            self.agreement.reach();
            happened.push(Happening::Reached(self.at()));
        }
        let others = Others { parts: heartbeats.clone().map(Part::from), misses_any: view.misses_any };
        let progress = self.agreement.advance(&others);
        self.move_on(progress, heartbeats, happened);
        let (centre_ne_m, centre_velocity_ne_m_s) = self.centre();
        let step = self.at() as usize;
        Task::Formation(Goal { step, centre_ne_m, centre_velocity_ne_m_s, heading_rad: self.heading_rad })
    }

    /// The collective is at its limit and the vehicle does not come nearer to its altitude.
    fn is_without_authority(estimate: &Estimate, view: &View) -> bool {
        let Some((error_m, limit)) = view.altitude_error_m.zip(view.collective_limit) else { return false };
        let nearing_m_s = -estimate.velocity.down_m_s() * error_m.signum();
        limit.is_towards(error_m) && nearing_m_s < STUCK_M_S
    }

    /// Lets time pass within the step. True if nothing of it is left to this vehicle.
    fn is_over<'a>(
        &mut self,
        now: PlantTime,
        in_place: bool,
        heartbeats: impl Iterator<Item = &'a message::Mission> + Clone,
    ) -> bool {
        let at = self.at();
        let Some(leg) = self.legs.get(at as usize) else { return false };
        let members = heartbeats.filter(|heartbeat| heartbeat.membership == Membership::Active);
        let live = members.clone().count() + 1;
        self.progress.pass(now, leg, in_place, along_m(members, at), live);
        self.progress.is_over(leg)
    }

    /// On the ground there is nothing to hold.
    fn hold(&mut self, estimate: &Estimate) -> Task {
        self.progress.pause();
        if estimate.height_m < FLYING_ABOVE_M && !self.at_altitude && self.stay.is_none() {
            self.activity = Activity::Holding;
            return Task::Wait;
        }
        if self.landing.take().is_some() {
            self.agreement.turn(Membership::Active);
        }
        self.stay(estimate, Activity::Holding)
    }

    fn stay(&mut self, estimate: &Estimate, activity: Activity) -> Task {
        self.activity = activity;
        let Place { at_ne_m, altitude_m } = *self.place(estimate);
        let lands = activity == Activity::Landing;
        Task::Stay { at_ne_m, altitude_m, heading_rad: self.heading_rad, lands }
    }

    /// The place to stay at: where the vehicle was when staying began.
    fn place(&mut self, estimate: &Estimate) -> &mut Place {
        self.stay.get_or_insert_with(|| Place {
            at_ne_m: estimate.position.horizontal(),
            altitude_m: estimate.position.altitude_m(),
        })
    }

    /// On the ground after a flight: there is no way back.
    fn is_down(&self) -> bool {
        self.landing.is_some_and(|landing| landing.is_on_ground())
    }

    /// The way down of a vehicle of which something has failed. On the ground there is nothing to autorotate.
    fn come_down(&mut self, now: Now, estimate: &Estimate, response: Response) -> Task {
        let task = self.land(now, estimate);
        match task {
            Task::Stay { heading_rad, .. } if response == Response::Autorotate => Task::Autorotate { heading_rad },
            _ => task,
        }
    }

    fn land(&mut self, now: Now, estimate: &Estimate) -> Task {
        let is_on_ground = self.activity == Activity::Joining && estimate.height_m < FLYING_ABOVE_M;
        self.agreement.turn(Membership::Left);
        let mut landing = self.landing.unwrap_or_else(|| Landing::begin(now.plant, is_on_ground));
        let altitude_m = self.place(estimate).altitude_m;
        let descent = landing.step(now.plant, estimate, altitude_m, self.above_altitude_m);
        self.landing = Some(landing);
        match descent {
            Descent::To(altitude_m) => {
                self.place(estimate).altitude_m = altitude_m;
                self.stay(estimate, Activity::Landing)
            }
            Descent::Unloading => {
                self.activity = Activity::Landing;
                Task::Park
            }
            Descent::Down => {
                self.activity = Activity::Landed;
                Task::Park
            }
        }
    }
}

/// How far those of these heartbeats' senders that are at this step take the centre to be, m.
fn along_m<'a>(heartbeats: impl Iterator<Item = &'a message::Mission>, at: u32) -> impl Iterator<Item = f64> {
    heartbeats.filter(move |heartbeat| heartbeat.step == at).map(|heartbeat| heartbeat.progress_m)
}

#[cfg(test)]
mod tests;
