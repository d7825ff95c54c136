//! Measures how the controllers handle their vehicles: the heading, the turn rate, and controls at their stops.

use std::collections::VecDeque;
use std::f64::consts::FRAC_PI_2;

use skein_common::frame::wrap_rad;
use skein_common::id::VehicleId;

use super::{AIRBORNE_ABOVE_M, STEADY_S, VehicleNow, VehicleReport, index};

/// The samples are summed up over spans of this length, s.
const SPAN_S: f64 = 5.0;
/// Number of spans that are kept: those of the last [`STEADY_S`], and the present one.
const SPANS: usize = (STEADY_S / SPAN_S) as usize + 1;
/// A turn rate over a longer time than this is unknown, s: the vehicle may have turned around in between.
const LONGEST_STEP_S: f64 = 1.0;

/// The handling of the vehicles by their controllers in the last part of the window: its last [`STEADY_S`], or its second half if
/// that is shorter, to within a span.
#[derive(Debug)]
pub(super) struct Handling {
    vehicles: Vec<Handled>,
    /// Whether each vehicle keeps its heading. A law of one's own may turn it.
    keeps_heading: bool,
}

/// One vehicle.
#[derive(Clone, Debug, Default)]
struct Handled {
    /// The heading that the vehicle keeps: the one that its agent found, rad.
    kept_rad: Option<f64>,
    /// Time, s, and heading, rad, of the last sample.
    last: Option<(f64, f64)>,
    spans: VecDeque<Span>,
}

/// The samples of a span.
#[derive(Clone, Copy, Debug, Default)]
struct Span {
    /// Number of the span, from 0.
    nth: u32,
    samples: u16,
    /// Sum of the squares of the heading's error, rad².
    square: f32,
    /// Largest turn rate, rad/s.
    turn_rate_rad_s: f32,
    /// Samples with controls, and of these those with one at its stop.
    controlled: u16,
    stopped: u16,
}

impl Handling {
    pub(super) fn new(vehicles: usize, keeps_heading: bool) -> Self {
        Self { vehicles: vec![Handled::default(); vehicles], keeps_heading }
    }

    /// Observes all vehicles ten times a second. Only live members in the air count.
    pub(super) fn observe(&mut self, t_s: f64, vehicles: &[VehicleNow]) {
        for vehicle in vehicles {
            let Some(handled) = self.vehicles.get_mut(index(vehicle.id)) else { continue };
            let kept_rad = *handled.kept_rad.get_or_insert(vehicle.truth.attitude.heading_rad);
            if vehicle.is_live_member() {
                handled.observe(t_s, vehicle, kept_rad);
            } else {
                handled.last = None;
            }
        }
    }

    /// The vehicle has a new agent, which keeps the heading that it finds.
    pub(super) fn restarted(&mut self, id: VehicleId) {
        if let Some(handled) = self.vehicles.get_mut(index(id)) {
            (handled.kept_rad, handled.last) = (None, None);
        }
    }

    /// The figures of a vehicle, counted from 0, `t_s` seconds into the window, as far as they are about its handling.
    pub(super) fn figures(&self, nth: usize, t_s: f64) -> VehicleReport {
        let since_s = t_s - STEADY_S.min(t_s / 2.0);
        let (mut square, mut fastest, mut saturation) = ((0.0, 0.0), None, (0.0, 0.0));
        for span in self.vehicles[nth].spans.iter().filter(|span| f64::from(span.nth + 1) * SPAN_S > since_s) {
            square = (square.0 + f64::from(span.square), square.1 + f64::from(span.samples));
            fastest = Some(f64::from(span.turn_rate_rad_s).max(fastest.unwrap_or_default()));
            saturation = (saturation.0 + f64::from(span.stopped), saturation.1 + f64::from(span.controlled));
        }
        let of_samples = |(sum, count): (f64, f64)| (count > 0.0).then(|| sum / count);
        let square = of_samples(square).filter(|_| self.keeps_heading);
        VehicleReport {
            heading_error_rms_deg: square.map(|square| square.sqrt().to_degrees()),
            max_turn_rate_deg_s: fastest.map(f64::to_degrees),
            stick_saturation: of_samples(saturation),
            ..VehicleReport::default()
        }
    }
}

impl Handled {
    fn observe(&mut self, t_s: f64, vehicle: &VehicleNow, kept_rad: f64) {
        let attitude = &vehicle.truth.attitude;
        let heading_rad = attitude.heading_rad;
        let last = self.last.replace((t_s, heading_rad));
        // Nose up or down, a vehicle has no heading.
        if vehicle.truth.height_m <= AIRBORNE_ABOVE_M || attitude.pitch_rad.abs() >= FRAC_PI_2 {
            return;
        }
        let span = self.span((t_s / SPAN_S).max(0.0) as u32);
        let error_rad = wrap_rad(heading_rad - kept_rad) as f32;
        span.square += error_rad * error_rad;
        span.samples += 1;
        if let Some((last_s, last_rad)) =
            last.filter(|(last_s, _)| (f64::EPSILON..=LONGEST_STEP_S).contains(&(t_s - last_s)))
        {
            let rate_rad_s = wrap_rad(heading_rad - last_rad).abs() / (t_s - last_s);
            span.turn_rate_rad_s = span.turn_rate_rad_s.max(rate_rad_s as f32);
        }
        if let Some(controls) = vehicle.controls {
            span.controlled += 1;
            span.stopped += u16::from(controls.is_at_a_stop());
        }
    }

    /// The span with this number.
    fn span(&mut self, nth: u32) -> &mut Span {
        if self.spans.back().is_none_or(|span| span.nth != nth) {
            if self.spans.len() == SPANS {
                self.spans.pop_front();
            }
            self.spans.push_back(Span { nth, ..Span::default() });
        }
        let newest = self.spans.len() - 1;
        &mut self.spans[newest]
    }
}

#[cfg(test)]
mod tests {
    use skein_core::plant::Controls;

    use super::super::tests::vehicle;
    use super::*;

    /// A vehicle in the air that has this heading, degrees, and this yaw control.
    fn at(heading_deg: f64, yaw: f64) -> VehicleNow {
        let mut vehicle = vehicle(1, 0.0, 100.0, 30.0);
        vehicle.truth.attitude.heading_rad = wrap_rad(heading_deg.to_radians());
        vehicle.controls = Some(Controls { yaw, collective: 0.6, ..Controls::default() });
        vehicle
    }

    /// The figures after a flight of this length with this heading, degrees, and yaw control at each time, s.
    fn flown(duration_s: u32, of: impl Fn(f64) -> (f64, f64)) -> VehicleReport {
        let mut handling = Handling::new(1, true);
        for tick in 0..=10 * duration_s {
            let t_s = f64::from(tick) / 10.0;
            let (heading_deg, yaw) = of(t_s);
            handling.observe(t_s, &[at(heading_deg, yaw)]);
        }
        handling.figures(0, f64::from(duration_s))
    }

    #[track_caller]
    fn near(figure: Option<f64>, expected: f64) {
        let figure = figure.unwrap();
        assert!((figure - expected).abs() <= 2e-3 * expected.abs() + 1e-4, "{figure}, not {expected}");
    }

    #[test]
    fn a_vehicle_that_spins_has_every_error_and_its_turn_rate() {
        let spinning = flown(200, |t_s| (170.0 + 108.0 * t_s, 1.0));
        near(spinning.heading_error_rms_deg, 180.0 / 3.0_f64.sqrt());
        near(spinning.max_turn_rate_deg_s, 108.0);
        assert_eq!(spinning.stick_saturation, Some(1.0));
    }

    #[test]
    fn only_the_last_part_of_the_window_counts() {
        // It turns to 10° off its heading within the first 20 s, at -9°/s.
        let turned =
            |t_s: f64| (if t_s < 20.0 { 190.0 - 9.0 * t_s } else { 180.0 }, if t_s < 30.0 { -1.0 } else { 0.3 });
        let long = flown(200, turned);
        near(long.heading_error_rms_deg, 10.0);
        near(long.max_turn_rate_deg_s, 0.0);
        assert_eq!(long.stick_saturation, Some(0.0));
        // Of 40 s the second half counts, in which the control was at its stop for ten of twenty seconds.
        let short = flown(40, turned);
        near(short.heading_error_rms_deg, 10.0);
        // The last sample begins a span of its own.
        near(short.stick_saturation, 100.0 / 201.0);
    }

    #[test]
    fn a_vehicle_on_the_ground_or_without_an_agent_does_not_count() {
        let mut handling = Handling::new(1, true);
        let mut grounded = at(50.0, 1.0);
        grounded.truth.height_m = 0.3;
        let mut flying = at(95.0, 0.0);
        for tick in 0..100 {
            handling.observe(f64::from(tick) / 10.0, &[grounded]);
        }
        assert_eq!(handling.figures(0, 10.0), VehicleReport::default());
        handling.observe(10.0, &[flying]);
        near(handling.figures(0, 10.1).heading_error_rms_deg, 45.0);
        // A new agent keeps the heading that it finds.
        flying.runs = false;
        handling.observe(10.1, &[flying]);
        handling.restarted(flying.id);
        flying.runs = true;
        (102..400).for_each(|tick| handling.observe(f64::from(tick) / 10.0, &[flying]));
        near(handling.figures(0, 40.0).heading_error_rms_deg, 0.0);
        assert_eq!(Handling::new(2, false).figures(1, 10.0).heading_error_rms_deg, None);
    }
}
