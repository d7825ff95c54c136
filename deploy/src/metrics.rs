//! One definition of every figure, for live runs, recordings and studies alike.
//!
//! Everything is measured on how the vehicles really were ([`VehicleNow::truth`]), never on what they believed.
//!
//! * **Settling** figures (`at_altitude_s`, `in_band_s`, `even_*_s`) are the first time after which the condition holds to the
//!   end of the window; what never settles is `null` and stands in `never`.
//! * **Steady** figures use the last [`STEADY_S`] of the window and are `null` in a shorter one.
//! * Separations and collisions count pairs of which both are higher than [`AIRBORNE_ABOVE_M`].
//! * `null` otherwise means that a figure does not apply to this run.

mod report;
mod series;

use std::f64::consts::TAU;

use nalgebra::Vector2;
use skein_agent::formation::{self, ring::Ring};
use skein_agent::plant::{Sticks, Truth};
use skein_common::id::VehicleId;
use skein_common::scenario::{Scenario, Target};

pub use report::{DIRECTIONS, Direction, Report, Run, VehicleReport, WALL_CLOCK_KEYS, Wall};
use series::{AgeHistogram, RadialSeries, Settling};

/// Steady figures use this much of the window's end, s.
pub const STEADY_S: f64 = 100.0;
/// Pairs count as airborne above this height, m.
pub const AIRBORNE_ABOVE_M: f64 = 2.0;
/// Pairs below this distance have collided, m.
pub const COLLISION_M: f64 = 2.0;
/// Share of the altitude at which a vehicle is "at altitude".
const AT_ALTITUDE_SHARE: f64 = 0.9;

/// One vehicle at one instant.
#[derive(Clone, Copy, Debug)]
pub struct VehicleNow {
    /// Who.
    pub id: VehicleId,
    /// Whether it is a member of the formation, which settling and spacing are about.
    pub is_member: bool,
    /// How it really is.
    pub truth: Truth,
    /// Its controls, if anybody holds them.
    pub sticks: Option<Sticks>,
}

/// Measures a run while it happens.
#[derive(Debug)]
pub struct Metrics {
    run: Run,
    ring: Ring,
    centre_ne_m: Vector2<f64>,
    altitude_m: f64,
    t_s: f64,
    at_altitude: Settling,
    in_band: Settling,
    even_10deg: Settling,
    even_5deg: Settling,
    radial: Vec<RadialSeries>,
    spacing: series::Window,
    centroid: series::Window,
    nearest_pair_m: Option<f64>,
    separations: Vec<f64>,
    max_tilt_rad: f64,
    stick_square: series::Mean,
    effort: Vec<Effort>,
    ages: AgeHistogram,
    steps_us: Vec<f64>,
    bearings: Vec<f64>,
    totals: Totals,
}

/// What all agents together have counted since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// States said.
    pub state_messages: u64,
    /// Their payload, bytes.
    pub state_bytes: u64,
    /// How often safety filters have stepped in; `None` without filters.
    pub safety_activations: Option<u64>,
    /// Steps that ended after the next frame was due.
    pub frame_overruns: u64,
}

/// What one vehicle spent.
#[derive(Clone, Copy, Debug, Default)]
struct Effort {
    energy_j: Option<f64>,
    stick_square: series::Mean,
}

impl Metrics {
    /// Nothing measured yet.
    pub fn new(scenario: &Scenario, run: Run) -> Self {
        let vehicles = scenario.swarm.vehicles;
        let centre_ne_m = match scenario.mission.steps.first().map(|step| &step.target) {
            Some(Target::Centre(centre)) => Vector2::from(*centre),
            _ => Vector2::zeros(),
        };
        Self {
            run,
            ring: formation::ring(&scenario.formation),
            centre_ne_m,
            altitude_m: scenario.formation.altitude_m,
            t_s: 0.0,
            at_altitude: Settling::default(),
            in_band: Settling::default(),
            even_10deg: Settling::default(),
            even_5deg: Settling::default(),
            radial: vec![RadialSeries::default(); vehicles],
            spacing: series::Window::default(),
            centroid: series::Window::default(),
            nearest_pair_m: None,
            separations: vec![f64::INFINITY; vehicles * vehicles],
            max_tilt_rad: 0.0,
            stick_square: series::Mean::default(),
            effort: vec![Effort::default(); vehicles],
            ages: AgeHistogram::default(),
            steps_us: Vec::new(),
            bearings: Vec::with_capacity(vehicles),
            totals: Totals::default(),
        }
    }

    /// All vehicles that still report at `t_s` seconds into the window; call it about fifty times a second.
    pub fn observe(&mut self, t_s: f64, vehicles: &[VehicleNow]) {
        let dt_s = t_s - self.t_s;
        self.t_s = t_s;
        self.observe_members(t_s, vehicles);
        self.observe_pairs(vehicles);
        for vehicle in vehicles {
            let truth = &vehicle.truth;
            let tilt_rad = truth.attitude.roll_rad.abs().max(truth.attitude.pitch_rad.abs());
            self.max_tilt_rad = self.max_tilt_rad.max(tilt_rad);
            let Some(effort) = self.effort.get_mut(index(vehicle.id)) else { continue };
            if let Some(power_w) = truth.power_w {
                *effort.energy_j.get_or_insert(0.0) += power_w * dt_s;
            }
            if let Some(sticks) = vehicle.sticks {
                let square = (sticks.roll.powi(2) + sticks.pitch.powi(2) + sticks.yaw.powi(2)) / 3.0;
                effort.stick_square.add(square);
                self.stick_square.add(square);
            }
        }
    }

    /// Age of one peer's word at one step, s, by the receiver's clock; of a peer that is not lost.
    pub fn observe_age(&mut self, age_s: f64) {
        self.ages.add(age_s);
    }

    /// Time from one frame's arrival to its last control, µs.
    pub fn observe_step(&mut self, step_us: f64) {
        self.steps_us.push(step_us);
    }

    /// Totals over all vehicles since the start.
    pub fn count(&mut self, totals: Totals) {
        self.totals = totals;
    }

    /// Seconds into the window.
    pub fn t_s(&self) -> f64 {
        self.t_s
    }

    /// What the members' places say.
    fn observe_members(&mut self, t_s: f64, vehicles: &[VehicleNow]) {
        let (mut high, mut inside, mut sum_ne_m) = (true, true, Vector2::zeros());
        self.bearings.clear();
        for vehicle in vehicles.iter().filter(|vehicle| vehicle.is_member) {
            let from_centre_ne_m = vehicle.truth.position.horizontal() - self.centre_ne_m;
            let rho_m = self.ring.level_m(from_centre_ne_m);
            let altitude_m = vehicle.truth.position.altitude_m();
            high &= altitude_m >= AT_ALTITUDE_SHARE * self.altitude_m;
            inside &= self.is_in_band(rho_m);
            sum_ne_m += from_centre_ne_m;
            self.bearings.push(from_centre_ne_m.y.atan2(from_centre_ne_m.x));
            if let Some(series) = self.radial.get_mut(index(vehicle.id)) {
                series.add(t_s, rho_m, altitude_m - self.altitude_m);
            }
        }
        let members = self.bearings.len();
        let deviation_deg = largest_gap_deviation_rad(&mut self.bearings).map(f64::to_degrees);
        self.at_altitude.observe(t_s, members > 0 && high);
        self.in_band.observe(t_s, members > 0 && inside);
        self.even_10deg.observe(t_s, deviation_deg.is_some_and(|deviation| deviation < 10.0));
        self.even_5deg.observe(t_s, deviation_deg.is_some_and(|deviation| deviation < 5.0));
        if let Some(deviation_deg) = deviation_deg {
            self.spacing.add(t_s, deviation_deg);
        }
        if members > 0 {
            self.centroid.add(t_s, sum_ne_m.norm() / members as f64);
        }
    }

    /// What every pair's distance says.
    fn observe_pairs(&mut self, vehicles: &[VehicleNow]) {
        let count = self.radial.len();
        let mut nearest_square = f64::INFINITY;
        for (nth, one) in vehicles.iter().enumerate() {
            for other in &vehicles[..nth] {
                if one.truth.height_m <= AIRBORNE_ABOVE_M || other.truth.height_m <= AIRBORNE_ABOVE_M {
                    continue;
                }
                let square = (one.truth.position - other.truth.position).norm_squared();
                nearest_square = nearest_square.min(square);
                let (low, high) = (index(one.id).min(index(other.id)), index(one.id).max(index(other.id)));
                if let Some(least) = self.separations.get_mut(low * count + high) {
                    *least = least.min(square);
                }
            }
        }
        self.nearest_pair_m = nearest_square.is_finite().then(|| nearest_square.sqrt());
    }

    fn is_in_band(&self, rho_m: f64) -> bool {
        let Ring { radius_m, inner_width_m, outer_width_m, .. } = self.ring;
        (radius_m - inner_width_m..=radius_m + outer_width_m).contains(&rho_m)
    }
}

/// Where the vehicle stands in tables that are in the order of ids.
fn index(id: VehicleId) -> usize {
    usize::from(id.get()) - 1
}

/// Largest deviation of a gap between neighbouring bearings from the even gap; `None` for fewer than two. Sorts them.
pub fn largest_gap_deviation_rad(bearings_rad: &mut [f64]) -> Option<f64> {
    let count = bearings_rad.len();
    if count < 2 {
        return None;
    }
    bearings_rad.sort_unstable_by(f64::total_cmp);
    let even = TAU / count as f64;
    let across = bearings_rad[0] + TAU - bearings_rad[count - 1];
    let within = bearings_rad.windows(2).map(|pair| pair[1] - pair[0]);
    Some(within.chain([across]).map(|gap| (gap - even).abs()).fold(0.0, f64::max))
}

#[cfg(test)]
mod tests;
