//! The figures of one run as written to `metrics.json`.

use std::collections::BTreeMap;

use super::figures::{Report, VehicleReport};
use super::run::Wall;
use super::series::{Worst, extremes};
use super::steady::Column;
use super::{Metrics, SETTLING, STEADY_S};

/// The figures of how long the swarm takes to react to a fault.
const DELAYS: [&str; 4] = ["detection_s", "rejoin_s", "response_s", "transient_s"];

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
        let worst = |figure: fn(&VehicleReport) -> Option<f64>| vehicle.values().filter_map(figure).reduce(f64::max);
        let settled_s = self.settling.map(|settling| settling.since_s);
        let [at_altitude_s, in_band_s, even_10deg_s, even_5deg_s] = settled_s;
        let delays = self.delays_after_faults();
        let [detection_s, rejoin_s, response_s, transient_s] = delays.each_ref().map(Worst::s);
        let collisions = self.separations.collisions();
        let pairs = self.separations.pairs();
        let live = !self.steps_us.is_empty();
        let with_several_steps = |figure: Option<u64>| figure.filter(|_| self.shapes.len() > 1);
        Report {
            run: self.run.clone(),
            duration_s: self.t_s,
            at_altitude_s,
            in_band_s,
            even_10deg_s,
            even_5deg_s,
            radial_rms_m: when_radial(mean_of_members(Column::SquareError).map(f64::sqrt)),
            radial_mean_m: when_radial(mean_of_members(Column::Rho)),
            radial_min_m: when_radial(extremes_of(Column::LeastRho).map(|(least, _)| least)),
            radial_max_m: when_radial(extremes_of(Column::LargestRho).map(|(_, largest)| largest)),
            spacing_error_deg: when_steady(mean(Column::Spacing)),
            nearest_pair_end_m: self.separations.nearest_now_m(),
            min_separation_m: self.separations.least_m(),
            collisions,
            crashes: self.crashes.iter().filter(|crash| crash.has_crashed).count() as u64,
            safety_activations: self.totals.safety_activations,
            oscillation_m: extremes(oscillations_m).map(|(_, largest)| largest),
            max_tilt_deg: self.max_tilt_rad.to_degrees(),
            altitude_rms_m: when_steady(mean_of_members(Column::SquareAltitudeError).map(f64::sqrt)),
            stick_rms: self.stick_square.mean().map(f64::sqrt),
            heading_error_rms_deg: worst(|vehicle| vehicle.heading_error_rms_deg),
            max_turn_rate_deg_s: worst(|vehicle| vehicle.max_turn_rate_deg_s),
            stick_saturation: worst(|vehicle| vehicle.stick_saturation),
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
            velocity_correlation: when_steady(mean(Column::Correlation)),
            collision_risk: self.separations.risk.mean(),
            mean_speed_m_s: when_steady(mean(Column::Speed)),
            disconnected_vehicles: self.graph.disconnected.mean(),
            min_cluster_vehicles: self.graph.smallest.mean(),
            centroid_lag_m: if self.is_flock {
                self.following.lag_m.mean()
            } else {
                when_steady(mean(Column::CentroidLag))
            },
            max_centre_distance_m: self.following.farthest_m,
            setpoints_reached: self.steps.passed.map(u64::from),
            setpoint_skew: with_several_steps(self.steps.skew.map(u64::from)),
            advance_latency_s: self.steps.latency_s,
            forced_advances: with_several_steps(Some(self.forced_advances)),
            detection_s,
            false_suspicions: (pairs > 0.0).then_some(self.detection.false_suspicions),
            rejoin_s,
            response_s,
            transient_s,
            state_messages: self.totals.state_messages,
            state_bytes: self.totals.state_bytes,
            peer_age_p50_ms: self.ages_ms.quantile(0.5),
            peer_age_p99_ms: self.ages_ms.quantile(0.99),
            step_p50_us: self.steps_us.quantile(0.5),
            step_p99_us: self.steps_us.quantile(0.99),
            frame_overruns: (live || self.is_central).then_some(self.totals.frame_overruns),
            law_misses: self.totals.law_misses,
            fallback_share: worst(|vehicle| vehicle.fallback_share),
            wall_s: wall.wall_s,
            real_time_factor: wall.real_time_factor,
            never: self.never(settled_s, &delays),
            vehicle,
        }
    }

    /// The swarm's worst delays after injected faults, s, in the order of [`DELAYS`].
    fn delays_after_faults(&self) -> [Worst; DELAYS.len()] {
        let transient = if self.is_round { self.transients.worst(self.t_s) } else { Worst::default() };
        let Self { detection, t_s, .. } = self;
        [detection.detection(*t_s), detection.rejoin(*t_s), detection.response(*t_s), transient]
    }

    /// Keys of figures whose event could have happened but never did.
    fn never(&self, settled_s: [Option<f64>; SETTLING.len()], delays: &[Worst; DELAYS.len()]) -> Vec<&'static str> {
        // A figure that does not apply is not in `never`: the spacing of a single vehicle or of a flock, the altitude
        // on an ellipsoid, and settling where the swarm has to move on.
        let applies = |key: &str| match key {
            _ if self.places > 1 => false,
            "at_altitude_s" => self.has_altitude,
            "in_band_s" => self.is_radial,
            _ => self.is_round && self.run.vehicles > 1,
        };
        let unsettled = SETTLING.into_iter().zip(settled_s).filter(|(key, since_s)| since_s.is_none() && applies(key));
        let without_reaction = DELAYS.into_iter().zip(delays).filter(|(_, delay)| delay.is_never);
        unsettled.map(|(key, _)| key).chain(without_reaction.map(|(key, _)| key)).collect()
    }

    fn vehicles(&self, steady: bool) -> BTreeMap<String, VehicleReport> {
        let since_s = self.t_s - STEADY_S;
        let rows = self.effort.iter().enumerate().map(|(nth, effort)| {
            let figures = if steady { self.vehicle_series.figures(nth, since_s) } else { None };
            let radial = figures.filter(|_| self.is_radial);
            let report = VehicleReport {
                radial_rms_m: radial.map(|figures| figures.error_rms_m),
                radial_mean_m: radial.map(|figures| figures.rho_m),
                oscillation_m: figures.and_then(|figures| figures.oscillation_m),
                stick_rms: effort.stick_square.mean().map(f64::sqrt),
                fallback_share: effort.fallback.mean(),
                energy_j: effort.energy_j,
                ..self.handling.figures(nth, self.t_s)
            };
            ((nth + 1).to_string(), report)
        });
        rows.collect()
    }
}
