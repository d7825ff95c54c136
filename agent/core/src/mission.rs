//! The mission stage: joining, flying the mission's steps in formation, holding, landing.
//!
//! ```text
//!        2 s of listening, rotor at speed        order to land, last step, a failure
//!   Joining ------------------------> Active ---------------------------> Left (descends, lands)
//!      ^                               | formation <----> hold (ordered, or too few peers in contact)
//!      +--- own data lost, released ---+
//!           or on hold alone
//! ```
//!
//! The swarm has no leader. The vehicles agree on the current step ([`agreement`]) and on a moving centre ([`progress`]).
//! Orders are registers ([`StandingOrders`]): every agent repeats those that it knows, so that an order that reaches one
//! vehicle reaches all.
//!
//! An order to the whole swarm leaves the swarm together: all hold, or all land. An order that names vehicles takes them
//! out of the agreement, so that the others never wait for them. A named vehicle on hold, or released to a human pilot, is
//! not an active member: the others treat it as an obstacle and space themselves without it. When it is ordered to a step,
//! it holds its place for two seconds, as a restarted agent does, and joins again.

pub mod agreement;
mod approach;
pub mod landing;
pub mod plan;
pub mod progress;
mod stay;
pub mod task;

use alloc::vec::Vec;

use nalgebra::Vector2;
use skein_common::frame::PositionNed;
use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::{self, EventKind, Failure, Order, StandingOrders, Verb};
use skein_common::scenario::Scenario;
use skein_common::state::{Activity, Membership};
use skein_common::time::{LocalTime, Now, PlantTime};

use crate::deadlines::Deadline;
use crate::estimate::Estimate;
use crate::failsafe::{Condition, Conditions, Response};
use crate::peers::{PeerProgress, Report};
use crate::setpoint::CollectiveLimit;
use agreement::{Agreement, AgreementState, OtherStates, Progress};
use approach::Approach;
use landing::Landing;
use plan::{Kind, Leg};
use progress::LegProgress;
pub use task::{MissionGoal, Task};

/// Height of the centre of gravity above which a vehicle counts as flying, m.
const FLYING_ABOVE_M: f64 = 1.5;
/// A vehicle off its altitude that approaches it more slowly than this with the collective at its limit is stuck after
/// a while ([`Deadline::AltitudeStuck`]), m/s.
const STUCK_M_S: f64 = 0.3;
/// Largest altitude error at which a vehicle is at its altitude, m.
pub const AT_ALTITUDE_M: f64 = 1.0;
/// Height by which a healthy vehicle may hover above its altitude setpoint without auto-trim, m: the collective rules
/// leave an error that grows with airspeed, 2.4 m at 5 m/s and 7.6 m at 8 m/s.
const ABOVE_ALTITUDE_UNTRIMMED_M: f64 = 9.0;

/// The results of other stages that the mission needs.
#[derive(Clone, Copy, Debug, Default)]
pub struct View {
    /// A number that changes whenever the heartbeats may have changed in more than the centre's progress.
    pub revision: u64,
    /// Whether a further vehicle is not in contact and may be flying the mission.
    pub absent_may_fly: bool,
    /// The conditions found by the stages before the mission.
    pub conditions: Conditions,
    /// Altitude setpoint minus altitude, m; `None` before the first setpoint.
    pub altitude_error_m: Option<f64>,
    /// Length of the horizontal position error that the formation commands away, m; `None` before the first setpoint.
    pub error_m: Option<f64>,
    /// Whether the vehicle flies as its law commands, before the safety filter.
    pub follows_law: bool,
    /// Whether the measured position does not follow the vehicle.
    pub position_is_stuck: bool,
    /// The limit of the climb authority, if the controller is at one.
    pub collective_limit: Option<CollectiveLimit>,
    /// Whether the vehicle is where the formation commands it, at its altitude and slow.
    pub in_place: bool,
    /// Whether another team keeps this one from its next step.
    pub is_next_taken: bool,
    /// Whether the simulator delivers too few frames for a take-off.
    pub frames_are_too_few: bool,
    /// Whether a human pilot takes the controls by moving the stick.
    pub pilot_takes_over: bool,
    /// Whether the own partition flies above another one, of which this vehicle does not know where it is.
    pub flies_above: bool,
}

/// The mission stage of one vehicle.
#[derive(Clone, Debug)]
pub struct Mission {
    own: VehicleId,
    legs: Vec<Leg>,
    /// Hash of the plan.
    pub(crate) plan: u64,
    /// Rotor speed required for take-off, rad/s.
    take_off_rotor_rad_s: Option<f64>,
    /// Height by which a healthy vehicle may hover above its altitude setpoint, m.
    above_altitude_m: f64,
    /// Peers that fly another plan and have been reported.
    other_plans: VehicleSet,
    /// Time at which this agent began to listen.
    since: Option<LocalTime>,
    /// Whether it has listened long enough once.
    has_listened: bool,
    /// The vehicle's present activity.
    pub(crate) activity: Activity,
    agreement: Agreement,
    /// The inputs of the agreement when it last followed the others, and when it last could not advance: with the same
    /// inputs it decides the same.
    followed: Option<AgreementInputs>,
    blocked: Option<AgreementInputs>,
    /// Members that had not reached this step when they were last in contact.
    awaited: VehicleSet,
    /// Number of active members in contact, this vehicle included.
    live: usize,
    has_quorum: bool,
    /// All orders known.
    pub(crate) orders: StandingOrders,
    /// The last order that was new to this vehicle, whichever vehicle it is to.
    pub(crate) newest_order: Option<Order>,
    /// The order that named this vehicle last when a pilot took the controls by the stick, if one has and no later order
    /// has taken them back.
    taken_by_stick: Option<Option<Order>>,
    leaving: bool,
    heading_rad: f64,
    at_altitude: bool,
    /// Time for which the vehicle has been off its altitude and coming no nearer, with no collective left, s.
    stuck_s: f64,
    progress: LegProgress,
    approach: Approach,
    progress_timeout_s: f64,
    /// Since when a vehicle in the air could have joined, were it ready to fly.
    kept_out_since: Option<PlantTime>,
    /// Whether the vehicle has once come no nearer to a step, or to joining in the air, for too long: it lands for good.
    pub(crate) gave_up: bool,
    /// Whether this vehicle has once completed its step, except that the next one may be taken.
    pub(crate) is_complete: bool,
    /// The step has just begun, and other vehicles may be farther along it.
    is_late: bool,
    /// Position of the stay; `None` while the vehicle does not stay.
    stay: Option<PositionNed>,
    landing: Option<Landing>,
    /// Whether the landing waits because another partition may be below.
    landing_waits: bool,
}

/// The values on which the agreement's decisions depend.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct AgreementInputs {
    revision: u64,
    absent_may_fly: bool,
    own: AgreementState,
}

impl Mission {
    /// The mission of vehicle `own` of a scenario before its begin. The vehicle becomes an active member when the rotor has reached
    /// `take_off_rotor_rad_s`, if the plant reports the rotor's speed.
    pub fn new(scenario: &Scenario, own: VehicleId, take_off_rotor_rad_s: Option<f64>) -> Self {
        let legs = plan::legs(&scenario.mission);
        let last_step = legs.len().saturating_sub(1).min(message::MAX_STEP as usize) as u32;
        Self {
            own,
            legs,
            plan: scenario.plan_hash(),
            take_off_rotor_rad_s,
            above_altitude_m: if scenario.control.auto_trim { 0.0 } else { ABOVE_ALTITUDE_UNTRIMMED_M },
            other_plans: VehicleSet::default(),
            since: None,
            has_listened: false,
            activity: Activity::Joining,
            agreement: Agreement::new(scenario.roster(), last_step, scenario.mission.partition),
            followed: None,
            blocked: None,
            awaited: VehicleSet::default(),
            live: 1,
            has_quorum: true,
            orders: StandingOrders::default(),
            newest_order: None,
            taken_by_stick: None,
            leaving: false,
            heading_rad: 0.0,
            at_altitude: false,
            stuck_s: 0.0,
            progress: LegProgress::default(),
            approach: Approach::default(),
            progress_timeout_s: scenario.mission.progress_timeout_s,
            kept_out_since: None,
            gave_up: false,
            is_complete: false,
            is_late: false,
            stay: None,
            landing: None,
            landing_waits: false,
        }
    }

    /// Merges an order, and executes it if this vehicle obeys it.
    pub fn merge(&mut self, order: Order, happened: &mut Vec<EventKind>) {
        if !self.orders.merge(order) {
            return;
        }
        self.newest_order = Some(order);
        let is_obeyed = matches!(order.verb, Verb::Set(_)) || self.obeyed() == Some(order);
        happened.extend(is_obeyed.then_some(EventKind::OrderTaken(Order { signature: None, ..order })));
        let progress = match (order.verb, order.vehicles) {
            (Verb::Goto(step), None) => self.agreement.order(step),
            (Verb::Goto(step), Some(_)) if is_obeyed => self.agreement.carry(step),
            _ => None,
        };
        self.begin_step(progress, core::iter::empty(), happened);
    }

    /// The order that this vehicle obeys.
    fn obeyed(&self) -> Option<Order> {
        self.orders.obeyed_by(self.own)
    }

    /// Makes this vehicle land and leave the swarm, independently of the others.
    pub fn leave(&mut self) {
        self.leaving = true;
    }

    /// Withdraws a vehicle without own data, so that the swarm does not wait for it. It rejoins when the data are back.
    pub fn withdraw(&mut self) {
        if self.membership() == Membership::Active {
            self.leave_agreement();
        }
    }

    /// Merges the order that a peer's heartbeat repeats if the peer flies the same plan; otherwise reports the peer.
    pub fn take_report(&mut self, report: &Report, happened: &mut Vec<EventKind>) {
        let &Report { id, plan, order } = report;
        if plan == self.plan {
            order.into_iter().for_each(|order| self.merge(order, happened));
        } else if !self.other_plans.contains(id) {
            self.other_plans.insert(id);
            happened.push(EventKind::PlanDiffers(id));
        }
    }

    /// The task of this step, after the mission has taken all received orders. `heartbeats` are the newest ones of all
    /// peers in contact that fly the same plan, as kept by the peers stage. They contain the agreement states of these
    /// peers, and the centre's progress according to them.
    pub fn step(
        &mut self,
        now: Now,
        estimate: &Estimate,
        view: &View,
        heartbeats: impl Iterator<Item = PeerProgress> + Clone,
        happened: &mut Vec<EventKind>,
    ) -> Task {
        let since = *self.since.get_or_insert_with(|| {
            self.heading_rad = estimate.attitude.heading_rad;
            now.local
        });
        let absent_may_fly = view.absent_may_fly;
        if self.followed != Some(self.inputs(view)) {
            // They are read several times, and lie in many places.
            let read: Vec<PeerProgress> = heartbeats.clone().collect();
            let heartbeats = || read.iter().copied();
            let others = OtherStates { states: heartbeats().map(AgreementState::from), absent_may_fly };
            let progress = self.agreement.follow(&others);
            self.begin_step(progress, heartbeats(), happened);
            self.update_awaited(heartbeats());
            let live = others.live();
            if live != self.live {
                // Another member may have been in the way, or has a place now.
                self.approach.restart();
            }
            self.live = live;
            self.watch_quorum(self.agreement.has_quorum(&others), happened);
            self.followed = Some(self.inputs(view));
        }
        // An agent whose simulator was away has received its peers all the time. On the ground it need not listen again; in
        // the air it stays in place meanwhile.
        let knows_peers = self.has_listened && !view.conditions.contains(Condition::AllPeersLost);
        let is_back_on_ground = knows_peers && estimate.height_m < FLYING_ABOVE_M;
        let has_listened = is_back_on_ground || Deadline::Listened.is_past(now.local.seconds_since(since));
        self.has_listened |= has_listened;
        let is_late = core::mem::take(&mut self.is_late) || self.membership() == Membership::Joining;
        // Only along a path is there anything to catch up.
        if is_late && self.leg().is_some_and(|leg| matches!(leg.kind, Kind::Path(_))) {
            let others = OtherStates { states: heartbeats.clone().map(AgreementState::from), absent_may_fly };
            self.catch_up(&others, heartbeats.clone());
        }
        let may_fly = self.is_rotor_ready(estimate)
            && !view.position_is_stuck
            && (!view.frames_are_too_few || estimate.height_m > FLYING_ABOVE_M);
        if self.membership() == Membership::Joining && has_listened && may_fly {
            self.agreement.set_membership(Membership::Active);
        }
        self.watch_joining(now.plant, has_listened && estimate.height_m > FLYING_ABOVE_M, happened);
        self.decide(now, estimate, view, heartbeats, happened)
    }

    /// The agreement state of this vehicle, as sent to the peers.
    pub fn agreement_state(&self) -> AgreementState {
        self.agreement.own()
    }

    /// The vehicle's membership: whether the other vehicles wait for it.
    pub fn membership(&self) -> Membership {
        self.agreement.own().membership
    }

    /// The current step of this vehicle, counted from 0.
    pub fn at(&self) -> u32 {
        self.agreement.own().step
    }

    /// The highest step this agent has reached.
    pub fn reached(&self) -> Option<u32> {
        self.agreement.own().reached
    }

    /// Progress of the centre along this step's path according to this vehicle, m.
    pub fn progress_m(&self) -> f64 {
        self.progress.along_m
    }

    /// Position and velocity of the centre according to this vehicle, north and east, m and m/s.
    pub fn centre(&self) -> (Vector2<f64>, Vector2<f64>) {
        self.leg().map(|leg| self.progress.centre(leg)).unwrap_or_default()
    }

    /// Whether the mission has reached its landing step.
    pub fn is_at_landing(&self) -> bool {
        self.leg().is_some_and(|leg| leg.kind == Kind::Land)
    }

    /// Whether the vehicle has been off its altitude and coming no nearer for too long, with no collective left.
    pub fn is_stuck(&self) -> bool {
        Deadline::AltitudeStuck.is_past(self.stuck_s)
    }

    fn inputs(&self, view: &View) -> AgreementInputs {
        let View { revision, absent_may_fly, .. } = *view;
        AgreementInputs { revision, absent_may_fly, own: self.agreement.own() }
    }

    fn leg(&self) -> Option<&Leg> {
        self.legs.get(self.at() as usize)
    }

    fn decide(
        &mut self,
        now: Now,
        estimate: &Estimate,
        view: &View,
        heartbeats: impl Iterator<Item = PeerProgress> + Clone,
        happened: &mut Vec<EventKind>,
    ) -> Task {
        let order = self.obeyed();
        let (verb, is_alone) = (order.map(|order| order.verb), order.is_some_and(|order| order.vehicles.is_some()));
        let named = self.orders.naming(self.own);
        self.taken_by_stick = if view.pilot_takes_over { Some(named) } else { self.taken_by_stick };
        self.taken_by_stick = self.taken_by_stick.filter(|at_taking| *at_taking == named);
        if verb == Some(Verb::Release) || self.taken_by_stick.is_some() {
            return self.release();
        }
        let response = self.conditions(view).response();
        if matches!(response, Response::Land | Response::LandTurning | Response::Autorotate) {
            return self.descend(now, estimate, response);
        }
        // Above another partition the landing waits: the other one may be flying below, at the same places.
        let is_clear_below = !view.flies_above || self.landing.is_some();
        let is_complete = self.is_at_landing() && self.membership() != Membership::Joining && is_clear_below;
        let task = match (self.membership(), verb) {
            (_, Some(Verb::Land | Verb::Abort)) if self.stay.is_some() => self.land(now, estimate),
            (_, Some(Verb::Hold)) if is_alone && !self.leaving && !self.is_on_ground() => self.hold_alone(estimate),
            (Membership::Joining, _) if !self.leaving => self.join(estimate),
            (_, Some(Verb::Land | Verb::Abort)) => self.land(now, estimate),
            _ if self.leaving || is_complete || self.is_on_ground() => self.land(now, estimate),
            (_, Some(Verb::Hold)) => self.hold(estimate),
            _ if response == Response::Hold => self.hold(estimate),
            _ => self.fly(now, estimate, view, heartbeats, happened),
        };
        let is_due = self.is_at_landing() && self.membership() == Membership::Active && self.landing.is_none();
        let waits = is_due && !is_clear_below;
        happened.extend((waits && !self.landing_waits).then_some(EventKind::LandingWaits));
        self.landing_waits = waits;
        task
    }

    /// All conditions: those of the earlier stages and the mission's own.
    fn conditions(&self, view: &View) -> Conditions {
        let mut conditions = view.conditions;
        conditions.extend(self.is_stuck().then_some(Condition::AltitudeStuck));
        conditions.extend(self.gave_up.then_some(Condition::NoProgress));
        conditions.extend((!self.has_quorum).then_some(Condition::QuorumLost));
        conditions
    }

    /// Begins the step to which the agreement has moved, if it has, and reports the reason.
    fn begin_step(
        &mut self,
        progress: Option<Progress>,
        heartbeats: impl Iterator<Item = PeerProgress>,
        happened: &mut Vec<EventKind>,
    ) {
        let Some(progress) = progress else { return };
        let to = self.at();
        let without = core::mem::take(&mut self.awaited);
        let event = match progress {
            Progress::Advanced if without.is_empty() => EventKind::Advanced(to),
            Progress::Advanced => EventKind::ForcedAdvance { to, without },
            Progress::Carried { reached: true, .. } => EventKind::Advanced(to),
            Progress::Carried { from, reached: false } => EventKind::Skipped { from, to },
        };
        // A vehicle that has left only observes.
        happened.extend((self.membership() != Membership::Left).then_some(event));
        self.update_awaited(heartbeats);
        self.progress.begin_next();
        self.approach.restart();
        self.is_complete = false;
        self.is_late = true;
    }

    /// Updates the members that have not reached this step. Members out of contact stay unchanged.
    fn update_awaited(&mut self, heartbeats: impl Iterator<Item = PeerProgress>) {
        for heartbeat in heartbeats {
            let (id, state) = (heartbeat.id, AgreementState::from(heartbeat));
            if state.is_active() && !state.has_reached(self.at()) {
                self.awaited.insert(id);
            } else {
                self.awaited.remove(id);
            }
        }
    }

    /// Moves the centre of a late vehicle as far as two other vehicles report it, so that they hardly wait for it.
    fn catch_up(
        &mut self,
        others: &OtherStates<impl Iterator<Item = AgreementState> + Clone>,
        heartbeats: impl Iterator<Item = PeerProgress>,
    ) {
        let along_m = self.agreement.reliable(others, along_m(heartbeats, self.at()));
        along_m.into_iter().for_each(|along_m| self.progress.catch_up(along_m));
    }

    fn watch_quorum(&mut self, has_quorum: bool, happened: &mut Vec<EventKind>) {
        if has_quorum != self.has_quorum && self.membership() == Membership::Active {
            happened.push(if has_quorum { EventKind::QuorumBack } else { EventKind::QuorumLost });
        }
        self.has_quorum = has_quorum;
    }

    fn is_rotor_ready(&self, estimate: &Estimate) -> bool {
        let speeds = estimate.rotor_speed_rad_s.zip(self.take_off_rotor_rad_s);
        speeds.is_none_or(|(speed_rad_s, least_rad_s)| speed_rad_s >= least_rad_s)
    }

    /// Joining on the ground leaves the controls unchanged; joining in the air (after a restart) holds the position.
    fn join(&mut self, estimate: &Estimate) -> Task {
        if estimate.height_m > FLYING_ABOVE_M {
            self.stay(estimate, Activity::Joining)
        } else {
            self.activity = Activity::Joining;
            Task::Wait
        }
    }

    /// Flies the step's formation, and begins the next step when all members have reached this one.
    fn fly(
        &mut self,
        now: Now,
        estimate: &Estimate,
        view: &View,
        heartbeats: impl Iterator<Item = PeerProgress> + Clone,
        happened: &mut Vec<EventKind>,
    ) -> Task {
        self.stay = None;
        if self.landing.take().is_some() {
            // Recalled during the descent.
            self.agreement.set_membership(Membership::Active);
        }
        let is_at_altitude = view.altitude_error_m.is_some_and(|error_m| error_m.abs() < AT_ALTITUDE_M);
        self.at_altitude |= is_at_altitude;
        self.activity = if self.at_altitude { Activity::Formation } else { Activity::TakingOff };
        let is_stuck = !is_at_altitude && Self::is_without_authority(estimate, view);
        self.stuck_s = if is_stuck { self.stuck_s + self.progress.since_s(now.plant) } else { 0.0 };
        happened.extend(self.is_stuck().then_some(EventKind::Failed(Failure::Altitude)));
        let dt_s = self.progress.since_s(now.plant);
        let is_complete = self.completes(now.plant, view.in_place, heartbeats.clone());
        self.is_complete |= is_complete;
        self.watch_approach(dt_s, estimate, view, happened);
        if is_complete && !view.is_next_taken && self.reached() < Some(self.at()) {
            self.agreement.reach();
            happened.push(EventKind::Reached(self.at()));
        }
        self.advance(view, heartbeats, happened);
        let (centre_ne_m, centre_velocity_ne_m_s) = self.centre();
        let step = self.at() as usize;
        Task::Formation(MissionGoal { step, centre_ne_m, centre_velocity_ne_m_s, heading_rad: self.heading_rad })
    }

    /// Begins the next step if this vehicle and all others have reached this one.
    fn advance(
        &mut self,
        view: &View,
        heartbeats: impl Iterator<Item = PeerProgress> + Clone,
        happened: &mut Vec<EventKind>,
    ) {
        let inputs = self.inputs(view);
        if self.reached() < Some(self.at()) || self.blocked == Some(inputs) {
            return;
        }
        let others =
            OtherStates { states: heartbeats.clone().map(AgreementState::from), absent_may_fly: view.absent_may_fly };
        let progress = self.agreement.advance(&others);
        self.blocked = progress.is_none().then_some(inputs);
        self.begin_step(progress, heartbeats, happened);
    }

    /// Whether the collective is at its limit and the vehicle comes no nearer to its altitude.
    fn is_without_authority(estimate: &Estimate, view: &View) -> bool {
        let Some((error_m, limit)) = view.altitude_error_m.zip(view.collective_limit) else { return false };
        let nearing_m_s = -estimate.velocity.down_m_s() * error_m.signum();
        limit.is_towards(error_m) && nearing_m_s < STUCK_M_S
    }

    /// Advances the time within the step; returns whether this vehicle has completed it.
    fn completes(
        &mut self,
        now: PlantTime,
        in_place: bool,
        heartbeats: impl Iterator<Item = PeerProgress> + Clone,
    ) -> bool {
        let at = self.at();
        let Some(leg) = self.legs.get(at as usize) else { return false };
        let members = heartbeats.filter(|heartbeat| heartbeat.membership == Membership::Active);
        self.progress.advance(now, leg, in_place, along_m(members, at), self.live);
        self.progress.is_complete(leg)
    }
}

/// Progress of the centre according to those senders of these heartbeats that are at this step, m.
fn along_m(heartbeats: impl Iterator<Item = PeerProgress>, at: u32) -> impl Iterator<Item = f64> {
    heartbeats.filter(move |heartbeat| heartbeat.step == at).map(|heartbeat| heartbeat.progress_m)
}

#[cfg(test)]
mod tests;
