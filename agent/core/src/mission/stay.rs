//! The behaviour of a vehicle that does not fly its formation: it holds its place, lands, or leaves its controls to a human pilot.

use skein_common::frame::PositionNed;
use skein_common::state::{Activity, Membership};
use skein_common::time::Now;

use super::landing::{Descent, Landing};
use super::{FLYING_ABOVE_M, Mission, Task};
use crate::estimate::Estimate;
use crate::failsafe::Response;

impl Mission {
    /// Leaves the controls to a human pilot and the agreement to the others. The vehicle follows the others' steps, so that
    /// it joins again where they are.
    pub(super) fn release(&mut self) -> Task {
        self.leave_agreement();
        (self.stay, self.landing, self.stuck_s) = (None, None, 0.0);
        self.activity = Activity::Released;
        Task::Release
    }

    /// Holds the position by an order that names this vehicle: the others do not wait for it.
    pub(super) fn hold_alone(&mut self, estimate: &Estimate) -> Task {
        self.landing = None;
        self.leave_agreement();
        self.hold(estimate)
    }

    /// The others do not wait for this vehicle from now on. It listens again before it joins.
    pub(super) fn leave_agreement(&mut self) {
        self.agreement.set_membership(Membership::Joining);
        self.since = None;
        self.progress.pause();
    }

    /// Holds the position; on the ground there is nothing to hold.
    pub(super) fn hold(&mut self, estimate: &Estimate) -> Task {
        self.progress.pause();
        if estimate.height_m < FLYING_ABOVE_M && !self.at_altitude && self.stay.is_none() {
            self.activity = Activity::Holding;
            return Task::Wait;
        }
        if self.landing.take().is_some() {
            self.agreement.set_membership(Membership::Active);
        }
        self.stay(estimate, Activity::Holding)
    }

    pub(super) fn stay(&mut self, estimate: &Estimate, activity: Activity) -> Task {
        self.activity = activity;
        let place = self.place(estimate);
        let (at_ne_m, altitude_m) = (place.horizontal(), place.altitude_m());
        let lands = activity == Activity::Landing;
        Task::Stay { at_ne_m, altitude_m, heading_rad: self.heading_rad, lands }
    }

    /// The position of the stay: that of the vehicle when the stay began.
    fn place(&mut self, estimate: &Estimate) -> &mut PositionNed {
        self.stay.get_or_insert(estimate.position)
    }

    /// Whether the vehicle is on the ground after a flight, which is final.
    pub(super) fn is_on_ground(&self) -> bool {
        self.landing.is_some_and(|landing| landing.is_on_ground())
    }

    /// The descent of a vehicle with a failure; on the ground it does not autorotate.
    pub(super) fn descend(&mut self, now: Now, estimate: &Estimate, response: Response) -> Task {
        let task = self.land(now, estimate);
        match task {
            Task::Stay { heading_rad, .. } if response == Response::Autorotate => Task::Autorotate { heading_rad },
            _ => task,
        }
    }

    pub(super) fn land(&mut self, now: Now, estimate: &Estimate) -> Task {
        let is_on_ground = self.activity == Activity::Joining && estimate.height_m < FLYING_ABOVE_M;
        self.agreement.set_membership(Membership::Left);
        let mut landing = self.landing.unwrap_or_else(|| Landing::begin(now.plant, is_on_ground));
        let altitude_m = self.place(estimate).altitude_m();
        let descent = landing.step(now.plant, estimate, altitude_m, self.above_altitude_m);
        self.landing = Some(landing);
        match descent {
            Descent::To(altitude_m) => {
                self.place(estimate).0.z = -altitude_m;
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
