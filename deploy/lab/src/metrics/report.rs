//! The figures of one run as written to `metrics.json`.

use std::collections::BTreeMap;

use serde::Serialize;
use skein_common::scenario::{ModelKind, Scenario};

use super::series::{Worst, extremes};
use super::steady::Column;
use super::{Metrics, STEADY_S};

/// Identity of a run: scenario, seed and program.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Run {
    /// Name of the scenario.
    pub scenario: String,
    /// Preset of the scenario.
    pub preset: String,
    /// Formation law.
    pub law: String,
    /// Field conversion.
    pub conversion: String,
    /// Plant that flew: `builtin`, `standin`, `xplane`, or the built-in `point_mass`.
    pub plant: String,
    /// Command that flew: `fly` or `study`.
    pub target: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Version of the program.
    pub version: String,
    /// Git revision of the program.
    pub revision: String,
    /// Number of vehicles.
    pub vehicles: usize,
}

impl Run {
    /// The identity of a run of this scenario by the command `target`.
    pub fn new(scenario: &Scenario, target: &str) -> Self {
        Self {
            scenario: scenario.name.clone(),
            preset: scenario_spelling(&scenario.preset),
            law: scenario_spelling(&scenario.formation.law),
            conversion: scenario_spelling(&scenario.formation.conversion),
            plant: match scenario.plant.model {
                ModelKind::Helicopter => scenario_spelling(&scenario.swarm.plant),
                ModelKind::PointMass => scenario_spelling(&scenario.plant.model),
            },
            target: target.to_owned(),
            seed: scenario.seed,
            version: crate::VERSION.to_owned(),
            revision: crate::REVISION.to_owned(),
            vehicles: scenario.swarm.vehicles,
        }
    }

    /// The identity of a flight of a swarm, or of the teams of a fleet, with the fleet's seed. What the teams differ in is that of
    /// the first.
    pub fn of_all<'a>(mut teams: impl Iterator<Item = &'a Scenario>, target: &str) -> Self {
        let Some(first) = teams.next() else { return Self::default() };
        let run = Self::new(first, target);
        Self {
            seed: first.team.map_or(run.seed, |team| team.seed),
            vehicles: run.vehicles + teams.map(|team| team.swarm.vehicles).sum::<usize>(),
            ..run
        }
    }
}

/// The spelling of a choice in the scenario file.
fn scenario_spelling(choice: &impl Serialize) -> String {
    match serde_json::to_value(choice) {
        Ok(serde_json::Value::String(text)) => text,
        _ => String::new(),
    }
}

/// Duration of a run by the wall clock.
#[derive(Clone, Copy, Debug)]
pub struct Wall {
    /// Wall-clock time that the run took, s.
    pub wall_s: f64,
    /// Seconds flown, joining included, for each second of wall clock.
    pub real_time_factor: f64,
}

/// The contents of `metrics.json`.
#[derive(Clone, Debug, Serialize)]
#[expect(missing_docs, reason = "`figures.rs` lists every key, and the module above defines it")]
pub struct Report {
    #[serde(flatten)]
    pub run: Run,
    pub duration_s: f64,
    pub at_altitude_s: Option<f64>,
    pub in_band_s: Option<f64>,
    pub even_10deg_s: Option<f64>,
    pub even_5deg_s: Option<f64>,
    pub radial_rms_m: Option<f64>,
    pub radial_mean_m: Option<f64>,
    pub radial_min_m: Option<f64>,
    pub radial_max_m: Option<f64>,
    pub spacing_error_deg: Option<f64>,
    pub nearest_pair_end_m: Option<f64>,
    pub min_separation_m: Option<f64>,
    pub collisions: u64,
    pub crashes: u64,
    pub safety_activations: Option<u64>,
    pub oscillation_m: Option<f64>,
    pub max_tilt_deg: f64,
    pub altitude_rms_m: Option<f64>,
    pub stick_rms: Option<f64>,
    pub heading_error_rms_deg: Option<f64>,
    pub max_turn_rate_deg_s: Option<f64>,
    pub stick_saturation: Option<f64>,
    pub energy_j: Option<f64>,
    pub band_occupancy: Option<f64>,
    pub polarization: Option<f64>,
    pub order: Option<f64>,
    pub safety: Option<f64>,
    pub union: Option<f64>,
    pub connectivity: Option<f64>,
    pub connected_share: Option<f64>,
    pub velocity_correlation: Option<f64>,
    pub collision_risk: Option<f64>,
    pub mean_speed_m_s: Option<f64>,
    pub disconnected_vehicles: Option<f64>,
    pub min_cluster_vehicles: Option<f64>,
    pub centroid_lag_m: Option<f64>,
    pub max_centre_distance_m: Option<f64>,
    pub setpoints_reached: Option<u64>,
    pub setpoint_skew: Option<u64>,
    pub advance_latency_s: Option<f64>,
    pub forced_advances: Option<u64>,
    pub detection_s: Option<f64>,
    pub false_suspicions: Option<u64>,
    pub rejoin_s: Option<f64>,
    pub response_s: Option<f64>,
    pub transient_s: Option<f64>,
    pub state_messages: u64,
    pub state_bytes: u64,
    pub peer_age_p50_ms: Option<f64>,
    pub peer_age_p99_ms: Option<f64>,
    pub step_p50_us: Option<f64>,
    pub step_p99_us: Option<f64>,
    pub frame_overruns: Option<u64>,
    pub law_misses: Option<u64>,
    pub fallback_share: Option<f64>,
    pub wall_s: f64,
    pub real_time_factor: f64,
    /// Keys of figures whose event could have happened but never did.
    pub never: Vec<&'static str>,
    /// Radial error and effort of each vehicle, by id.
    pub vehicle: BTreeMap<String, VehicleReport>,
}

/// One vehicle's own figures.
#[derive(Clone, Copy, Debug, Serialize)]
#[expect(missing_docs, reason = "the same keys as the swarm's")]
pub struct VehicleReport {
    pub radial_rms_m: Option<f64>,
    pub radial_mean_m: Option<f64>,
    pub oscillation_m: Option<f64>,
    pub stick_rms: Option<f64>,
    pub heading_error_rms_deg: Option<f64>,
    pub max_turn_rate_deg_s: Option<f64>,
    pub stick_saturation: Option<f64>,
    pub fallback_share: Option<f64>,
    pub energy_j: Option<f64>,
}

impl Metrics {
    /// The figures of the run so far.
    pub fn report(&self, wall: Wall) -> Report {
        let steady = self.t_s >= STEADY_S - 0.01;
        let when_steady = |figure: Option<f64>| figure.filter(|_| steady);
        let since_s = self.t_s - STEADY_S;
        let when_radial = |figure: Option<f64>| figure.filter(|_| steady && self.is_radial);
        let mean = |column: Column| self.series.mean(column, since_s);
        let mean_of_members = |column: Column| self.series.mean_of_members(column, since_s);
        let extremes_of = |column: Column| extremes(self.series.values(column, since_s));
        let vehicle = self.vehicles(steady);
        let oscillations_m = vehicle.values().filter_map(|vehicle| vehicle.oscillation_m);
        let settled = self.settled();
        let handling = self.handling.worst(self.t_s);
        let delays_after_faults = self.delays_after_faults();
        let collisions = self.separations.collisions();
        let pairs = self.separations.pairs();
        let live = !self.steps_us.is_empty();
        let with_several_steps = |figure: Option<u64>| figure.filter(|_| self.shapes.len() > 1);
        Report {
            run: self.run.clone(),
            duration_s: self.t_s,
            at_altitude_s: settled[0].1,
            in_band_s: settled[1].1,
            even_10deg_s: settled[2].1,
            even_5deg_s: settled[3].1,
            radial_rms_m: when_radial(mean_of_members(Column::SquareError).map(f64::sqrt)),
            radial_mean_m: when_radial(mean_of_members(Column::Rho)),
            radial_min_m: when_radial(extremes_of(Column::LeastRho).map(|(least, _)| least)),
            radial_max_m: when_radial(extremes_of(Column::LargestRho).map(|(_, largest)| largest)),
            spacing_error_deg: when_steady(mean(Column::Spacing)),
            nearest_pair_end_m: self.separations.nearest_now_m(),
            min_separation_m: self.separations.least_m(),
            collisions,
            crashes: self.crashes.count(),
            safety_activations: self.totals.safety_activations,
            oscillation_m: extremes(oscillations_m).map(|(_, largest)| largest),
            max_tilt_deg: self.max_tilt_rad.to_degrees(),
            altitude_rms_m: when_steady(mean_of_members(Column::SquareAltitudeError).map(f64::sqrt)),
            stick_rms: self.stick_square.mean().map(f64::sqrt),
            heading_error_rms_deg: handling.heading_error_rms_deg,
            max_turn_rate_deg_s: handling.max_turn_rate_deg_s,
            stick_saturation: handling.stick_saturation,
            energy_j: self.effort.iter().filter_map(|effort| effort.energy_j).reduce(|sum, energy| sum + energy),
            band_occupancy: if self.is_flock {
                self.following.inside.mean()
            } else {
                when_radial(mean_of_members(Column::Inside))
            },
            polarization: when_steady(mean(Column::Polarization)),
            order: when_steady(mean(Column::Order)),
            safety: (pairs > 0.0).then(|| 1.0 - collisions as f64 / pairs),
            union: self.graph.union.mean(),
            connectivity: self.graph.connectivity.mean(),
            connected_share: self.graph.connected.mean(),
            velocity_correlation: when_steady(self.graph.correlation.mean(since_s)),
            collision_risk: self.separations.risk(),
            mean_speed_m_s: when_steady(mean(Column::Speed)),
            disconnected_vehicles: self.graph.disconnected.mean(),
            min_cluster_vehicles: self.graph.smallest.mean(),
            centroid_lag_m: if self.is_flock {
                self.following.lag_m.mean()
            } else {
                when_steady(mean(Column::CentroidLag))
            },
            max_centre_distance_m: self.following.farthest_m,
            setpoints_reached: self.steps.passed(),
            setpoint_skew: with_several_steps(self.steps.skew()),
            advance_latency_s: self.steps.latency_s(),
            forced_advances: with_several_steps(Some(self.forced_advances)),
            detection_s: delays_after_faults[0].1.s(),
            false_suspicions: (pairs > 0.0).then(|| self.detection.false_suspicions()),
            rejoin_s: delays_after_faults[1].1.s(),
            response_s: delays_after_faults[2].1.s(),
            transient_s: delays_after_faults[3].1.s(),
            state_messages: self.totals.state_messages,
            state_bytes: self.totals.state_bytes,
            peer_age_p50_ms: self.ages_ms.quantile(0.5),
            peer_age_p99_ms: self.ages_ms.quantile(0.99),
            step_p50_us: self.steps_us.quantile(0.5),
            step_p99_us: self.steps_us.quantile(0.99),
            frame_overruns: (live || self.is_central).then_some(self.totals.frame_overruns),
            law_misses: self.totals.law_misses,
            fallback_share: self.fallback.worst(),
            wall_s: wall.wall_s,
            real_time_factor: wall.real_time_factor,
            never: self.never(&settled, &delays_after_faults),
            vehicle,
        }
    }

    /// The settling figures, with the time since which each condition holds, s.
    fn settled(&self) -> [(&'static str, Option<f64>); 4] {
        [
            ("at_altitude_s", self.at_altitude.since_s()),
            ("in_band_s", self.in_band.since_s().filter(|_| self.is_radial)),
            ("even_10deg_s", self.even_10deg.since_s()),
            ("even_5deg_s", self.even_5deg.since_s()),
        ]
    }

    /// The figures of how the swarm reacted to injected faults.
    fn delays_after_faults(&self) -> [(&'static str, Worst); 4] {
        let transient = if self.is_round { self.transients.worst(self.t_s) } else { Worst::default() };
        [
            ("detection_s", self.detection.detection(self.t_s)),
            ("rejoin_s", self.detection.rejoin(self.t_s)),
            ("response_s", self.detection.response(self.t_s)),
            ("transient_s", transient),
        ]
    }

    /// Keys of figures whose event could have happened but never did.
    fn never(
        &self,
        settled: &[(&'static str, Option<f64>)],
        delays_after_faults: &[(&'static str, Worst)],
    ) -> Vec<&'static str> {
        // A figure that does not apply is not in `never`: the spacing of a single vehicle or of a flock, the altitude
        // on an ellipsoid, and settling where the swarm has to move on.
        let applies = |key: &str| match key {
            _ if self.places > 1 => false,
            "at_altitude_s" => self.has_altitude,
            "in_band_s" => self.is_radial,
            "even_10deg_s" | "even_5deg_s" => self.is_round && self.run.vehicles > 1,
            _ => true,
        };
        let unsettled = settled.iter().filter(|(key, since_s)| since_s.is_none() && applies(key)).map(|(key, _)| *key);
        unsettled.chain(delays_after_faults.iter().filter(|(_, worst)| worst.is_never()).map(|(key, _)| *key)).collect()
    }

    fn vehicles(&self, steady: bool) -> BTreeMap<String, VehicleReport> {
        let since_s = self.t_s - STEADY_S;
        let rows = self.effort.iter().enumerate().map(|(nth, effort)| {
            let figures = if steady { self.vehicle_series.figures(nth, since_s) } else { None };
            let radial = figures.filter(|_| self.is_radial);
            let handling = self.handling.figures(nth, self.t_s);
            let report = VehicleReport {
                radial_rms_m: radial.map(|figures| figures.error_rms_m),
                radial_mean_m: radial.map(|figures| figures.rho_m),
                oscillation_m: figures.and_then(|figures| figures.oscillation_m),
                stick_rms: effort.stick_square.mean().map(f64::sqrt),
                heading_error_rms_deg: handling.heading_error_rms_deg,
                max_turn_rate_deg_s: handling.max_turn_rate_deg_s,
                stick_saturation: handling.stick_saturation,
                fallback_share: self.fallback.share(nth),
                energy_j: effort.energy_j,
            };
            ((nth + 1).to_string(), report)
        });
        rows.collect()
    }
}
