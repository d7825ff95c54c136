//! The samples of steady figures, which use the last [`STEADY_S`] of the window: of the whole swarm, and of each vehicle.

use std::collections::VecDeque;

use skein_common::math;

use super::STEADY_S;
use super::series::{Mean, extremes, mean};

/// A value of the whole swarm at one instant.
#[derive(Clone, Copy, Debug)]
pub(super) enum Column {
    /// Largest deviation of a gap between neighbouring bearings from the even gap, degrees.
    Spacing,
    /// Distance of the members' centroid from the centre, m.
    CentroidLag,
    /// Polarization Φ, 0 to 1.
    Polarization,
    /// Mean over the members of the mean cosine between their own velocity and those of the members in contact.
    Order,
    /// Mean speed of the members, m/s: Vásárhelyi's φ^vel.
    Speed,
    /// Correlation of velocities within the components of the communication graph: Vásárhelyi's φ^corr.
    Correlation,
    /// Number of members.
    Members,
    /// Mean over the members of the level ρ: the distance from the centre in the metric of the formation's ellipse, m.
    Rho,
    /// Least and largest ρ of a member, m.
    LeastRho,
    LargestRho,
    /// Mean over the members of (ρ − R*)², m².
    SquareError,
    /// Mean over the members of the square of the altitude's error, m².
    SquareAltitudeError,
    /// Share of the members in the region of the formation: in the band, or inside the area.
    Inside,
}

const COLUMNS: usize = Column::Inside as usize + 1;

/// The values of the whole swarm over the last [`STEADY_S`].
#[derive(Clone, Debug, Default)]
pub(super) struct SwarmSeries(VecDeque<Row>);

#[derive(Clone, Copy, Debug)]
struct Row {
    t_s: f64,
    /// Not a number where a value does not exist.
    values: [f64; COLUMNS],
}

/// Largest number of rows for which memory is reserved at once.
const LARGEST_RESERVE: f64 = 10_000.0;

/// Sums over the members at one instant.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MemberSums {
    rho_m: Mean,
    square: Mean,
    altitude_square: Mean,
    inside: Mean,
    extremes_m: Option<(f64, f64)>,
}

impl MemberSums {
    /// Adds a member: its ρ and its R*, m, the error of its altitude, m, and whether it is in the region of the formation.
    pub(super) fn add(&mut self, rho_m: f64, radius_m: f64, altitude_error_m: Option<f64>, is_inside: bool) {
        self.rho_m.add(rho_m);
        self.square.add(math::square(rho_m - radius_m));
        altitude_error_m.into_iter().for_each(|error_m| self.altitude_square.add(math::square(error_m)));
        self.inside.add(f64::from(is_inside));
        let (least_m, largest_m) = self.extremes_m.unwrap_or((rho_m, rho_m));
        self.extremes_m = Some((least_m.min(rho_m), largest_m.max(rho_m)));
    }
}

impl SwarmSeries {
    /// Begins the next instant, without values.
    pub(super) fn begin(&mut self, t_s: f64) {
        while self.0.pop_front_if(|row| row.t_s < t_s - STEADY_S).is_some() {}
        if let (Some(last), true) = (self.0.back(), self.0.len() == self.0.capacity()) {
            // Room for a whole window, and not twice as much.
            let window = (STEADY_S / (t_s - last.t_s)).min(LARGEST_RESERVE) as usize + 8;
            self.0.reserve_exact(window.saturating_sub(self.0.len()));
        }
        self.0.push_back(Row { t_s, values: [f64::NAN; COLUMNS] });
    }

    /// Sets a value at this instant, if it exists.
    pub(super) fn set(&mut self, column: Column, value: impl Into<Option<f64>>) {
        if let (Some(row), Some(value)) = (self.0.back_mut(), value.into()) {
            row.values[column as usize] = value;
        }
    }

    /// Sets the values of the members at this instant.
    pub(super) fn set_members(&mut self, sums: &MemberSums) {
        let Some((least_m, largest_m)) = sums.extremes_m else { return };
        self.set(Column::Members, sums.rho_m.count() as f64);
        let means = [
            (Column::Rho, sums.rho_m),
            (Column::SquareError, sums.square),
            (Column::SquareAltitudeError, sums.altitude_square),
            (Column::Inside, sums.inside),
        ];
        means.into_iter().for_each(|(column, mean)| self.set(column, mean.mean()));
        self.set(Column::LeastRho, least_m);
        self.set(Column::LargestRho, largest_m);
    }

    /// The rows since `since_s`.
    fn since(&self, since_s: f64) -> impl Iterator<Item = &[f64; COLUMNS]> {
        self.0.iter().filter(move |row| row.t_s >= since_s).map(|row| &row.values)
    }

    /// The values since `since_s`.
    pub(super) fn values(&self, column: Column, since_s: f64) -> impl Iterator<Item = f64> {
        self.since(since_s).map(move |values| values[column as usize]).filter(|value| !value.is_nan())
    }

    /// Mean of the values since `since_s`; `None` without values.
    pub(super) fn mean(&self, column: Column, since_s: f64) -> Option<f64> {
        mean(self.values(column, since_s))
    }

    /// Mean since `since_s` of a value that is a mean over the members: every member counts alike at every instant.
    pub(super) fn mean_of_members(&self, column: Column, since_s: f64) -> Option<f64> {
        let values = self.since(since_s).map(|values| (values[column as usize], values[Column::Members as usize]));
        let values = values.filter(|(value, members)| !value.is_nan() && *members > 0.0);
        let (sum, count) =
            values.fold((0.0, 0.0), |(sum, count), (value, members)| (sum + value * members, count + members));
        (count > 0.0).then(|| sum / count)
    }
}

/// Number of samples of a vehicle that are packed together.
const SLICE: usize = 20;

/// The level ρ of each vehicle in its formation over the last [`STEADY_S`], a byte for each sample.
///
/// The samples of one instant are neighbours in memory, and their time is kept once.
#[derive(Clone, Debug)]
pub(super) struct VehicleSeries {
    vehicles: usize,
    /// Levels ρ are kept relative to this one, m.
    reference_m: f64,
    /// The times of all samples, s.
    times_s: VecDeque<f64>,
    /// The samples but for the last ones, one place for each vehicle and [`SLICE`] instants.
    slices: VecDeque<Slice>,
    /// The samples since then: ρ − reference, m, one place for each instant and vehicle; not a number without a sample.
    newest_m: Vec<f32>,
    /// The newest R* of each vehicle, m.
    radii_m: Vec<f32>,
}

/// [`SLICE`] samples of one vehicle.
#[derive(Clone, Copy, Debug)]
struct Slice {
    /// Least and largest ρ − reference, m.
    least_m: f32,
    largest_m: f32,
    /// R*, m.
    radius_m: f32,
    /// The place of each sample between the two, in parts of [`LARGEST_CODE`], or [`NO_SAMPLE`].
    codes: [u8; SLICE],
}

const LARGEST_CODE: u8 = 254;
const NO_SAMPLE: u8 = 255;

impl Slice {
    fn pack(samples_m: impl Iterator<Item = f32> + Clone, radius_m: f32) -> Self {
        let (least_m, largest_m) =
            extremes(samples_m.clone().filter(|sample_m| !sample_m.is_nan())).unwrap_or_default();
        let scale = f32::from(LARGEST_CODE) / (largest_m - least_m).max(f32::MIN_POSITIVE);
        let mut codes = [NO_SAMPLE; SLICE];
        for (code, sample_m) in codes.iter_mut().zip(samples_m) {
            if !sample_m.is_nan() {
                *code = ((sample_m - least_m) * scale + 0.5) as u8;
            }
        }
        Self { least_m, largest_m, radius_m, codes }
    }

    /// The samples, ρ − reference, m, as they were packed but for rounding; the extremes are exact.
    fn samples_m(&self) -> impl Iterator<Item = Option<f64>> {
        let &Self { least_m, largest_m, codes, .. } = self;
        let range_m = f64::from(largest_m) - f64::from(least_m);
        let sample_m = move |code| f64::from(least_m) + range_m * f64::from(code) / f64::from(LARGEST_CODE);
        codes.into_iter().map(move |code| (code != NO_SAMPLE).then(|| sample_m(code)))
    }
}

/// A vehicle's own steady figures, m.
#[derive(Clone, Copy, Debug)]
pub(super) struct OwnFigures {
    /// Root mean square of ρ − R*.
    pub(super) error_rms_m: f64,
    /// Mean ρ.
    pub(super) rho_m: f64,
    /// Half the peak-to-peak value of ρ after the removal of its quadratic trend.
    pub(super) oscillation_m: Option<f64>,
}

impl VehicleSeries {
    /// A series for this many vehicles, best for levels near `reference_m`.
    pub(super) fn new(vehicles: usize, reference_m: f64) -> Self {
        let (times_s, slices, newest_m) = (VecDeque::new(), VecDeque::new(), Vec::with_capacity(SLICE * vehicles));
        Self { vehicles, reference_m, times_s, slices, newest_m, radii_m: vec![0.0; vehicles] }
    }

    /// Begins the next instant, without a sample of any vehicle.
    pub(super) fn begin(&mut self, t_s: f64) {
        if self.newest_m.len() == SLICE * self.vehicles {
            self.end_slice(t_s);
        }
        self.times_s.push_back(t_s);
        self.newest_m.resize(self.newest_m.len() + self.vehicles, f32::NAN);
    }

    fn end_slice(&mut self, t_s: f64) {
        let is_over = |times_s: &VecDeque<f64>| times_s.get(SLICE - 1).is_some_and(|last_s| *last_s < t_s - STEADY_S);
        while !self.slices.is_empty() && is_over(&self.times_s) {
            self.times_s.drain(..SLICE);
            self.slices.drain(..self.vehicles);
        }
        if let (Some(last_s), true) = (self.times_s.back(), self.slices.len() == self.slices.capacity()) {
            // Room for a whole window, and not twice as much.
            let window = (STEADY_S / (t_s - last_s)).min(LARGEST_RESERVE) as usize + 2 * SLICE;
            self.times_s.reserve_exact(window.saturating_sub(self.times_s.len()));
            self.slices.reserve_exact((window / SLICE * self.vehicles).saturating_sub(self.slices.len()));
        }
        for (vehicle, &radius_m) in self.radii_m.iter().enumerate() {
            let samples_m = self.newest_m.iter().skip(vehicle).step_by(self.vehicles).copied();
            self.slices.push_back(Slice::pack(samples_m, radius_m));
        }
        self.newest_m.clear();
    }

    /// Adds the sample of a vehicle, counted from 0, at the present instant: its ρ and its R*, m.
    pub(super) fn add(&mut self, vehicle: usize, rho_m: f64, radius_m: f64) {
        let present = self.newest_m.len().saturating_sub(self.vehicles);
        if let (Some(newest_m), Some(newest_radius_m)) =
            (self.newest_m.get_mut(present + vehicle), self.radii_m.get_mut(vehicle))
        {
            *newest_m = (rho_m - self.reference_m) as f32;
            *newest_radius_m = radius_m as f32;
        }
    }

    /// The samples of a vehicle since `since_s`: times, s, ρ and R*, m.
    fn samples(&self, vehicle: usize, since_s: f64) -> impl Iterator<Item = (f64, f64, f64)> {
        let slices = self.slices.iter().skip(vehicle).step_by(self.vehicles);
        let packed = slices.flat_map(|slice| slice.samples_m().map(|sample_m| (sample_m, slice.radius_m)));
        let radius_m = self.radii_m[vehicle];
        let newest_m = self.newest_m.iter().skip(vehicle).step_by(self.vehicles);
        let newest = newest_m.map(move |&sample_m| (Some(f64::from(sample_m)).filter(|it| !it.is_nan()), radius_m));
        self.times_s.iter().zip(packed.chain(newest)).filter_map(move |(&t_s, (sample_m, radius_m))| {
            let rho_m = self.reference_m + sample_m.filter(|_| t_s >= since_s)?;
            Some((t_s, rho_m, f64::from(radius_m)))
        })
    }

    /// A vehicle's own figures since `since_s`; `None` for a vehicle that had left before.
    pub(super) fn figures(&self, vehicle: usize, since_s: f64) -> Option<OwnFigures> {
        let samples: Vec<_> = self.samples(vehicle, since_s).collect();
        let square = mean(samples.iter().map(|(_, rho_m, radius_m)| (rho_m - radius_m) * (rho_m - radius_m)))?;
        let rho_m = mean(samples.iter().map(|(_, rho_m, _)| *rho_m))?;
        Some(OwnFigures { error_rms_m: square.sqrt(), rho_m, oscillation_m: oscillation_m(&samples) })
    }
}

/// Half the peak-to-peak value of ρ after the removal of its quadratic trend, m.
fn oscillation_m(samples: &[(f64, f64, f64)]) -> Option<f64> {
    let (first_s, last_s) = (samples.first()?.0, samples.last()?.0);
    let middle_s = (first_s + last_s) / 2.0;
    let scale_s = ((last_s - first_s) / 2.0).max(f64::MIN_POSITIVE);
    // Abscissae from −1 to 1 keep the normal equations well conditioned.
    let points = samples.iter().map(|(t_s, rho_m, _)| ((t_s - middle_s) / scale_s, rho_m));
    let mut normal = nalgebra::Matrix3::zeros();
    let mut right = nalgebra::Vector3::zeros();
    for (x, y) in points.clone() {
        let row = nalgebra::Vector3::new(1.0, x, x * x);
        normal += row * row.transpose();
        right += row * *y;
    }
    let trend = normal.lu().solve(&right)?;
    let (low, high) = extremes(points.map(|(x, y)| y - (trend.x + trend.y * x + trend.z * x * x)))?;
    Some((high - low) / 2.0)
}

#[cfg(test)]
mod tests {
    use skein_core::random::{self, Purpose};

    use super::*;

    #[test]
    fn packed_samples_keep_extremes_gaps_and_times() {
        let mut rng = random::generator(1, None, Purpose::Study);
        let mut series = VehicleSeries::new(3, 100.0);
        let mut expected = [const { Vec::new() }; 3];
        let instants = (2.5 * STEADY_S / 0.02) as u32;
        for instant in 0..instants {
            let t_s = f64::from(instant) * 0.02;
            series.begin(t_s);
            for (vehicle, expected) in expected.iter_mut().enumerate() {
                // The second vehicle is absent for a while, and the third leaves early.
                let is_present = [true, !(9_000..9_123).contains(&instant), instant < 1_000][vehicle];
                if is_present {
                    let rho_m = 100.0 + random::standard_normal(&mut rng);
                    series.add(vehicle, rho_m, 99.0);
                    expected.push((t_s, rho_m));
                }
            }
        }
        let since_s = f64::from(instants - 1) * 0.02 - STEADY_S;
        for (vehicle, expected) in expected.iter().enumerate() {
            let expected: Vec<_> = expected.iter().copied().filter(|(t_s, _)| *t_s >= since_s).collect();
            let samples: Vec<_> = series.samples(vehicle, since_s).collect();
            assert_eq!(samples.len(), expected.len(), "vehicle {vehicle}");
            for (&(t_s, rho_m, radius_m), &(expected_s, expected_m)) in samples.iter().zip(&expected) {
                assert_eq!((t_s, radius_m), (expected_s, 99.0));
                assert!((rho_m - expected_m).abs() < 8.0 / 508.0, "{rho_m} instead of {expected_m}");
            }
            let of = |samples: &[(f64, f64)]| extremes(samples.iter().map(|(_, rho_m)| *rho_m));
            let kept: Vec<_> = samples.iter().map(|&(t_s, rho_m, _)| (t_s, rho_m)).collect();
            match (of(&kept), of(&expected)) {
                (Some(kept), Some(expected)) => {
                    assert!((kept.0 - expected.0).abs() < 1e-6 && (kept.1 - expected.1).abs() < 1e-6);
                }
                (kept, expected) => assert_eq!(kept, expected, "vehicle {vehicle} has left"),
            }
        }
        assert!(series.figures(2, since_s).is_none() && series.slices.len() < 3 * (5_000 / SLICE + 3));
    }

    #[test]
    fn every_member_counts_alike_in_a_mean_of_members() {
        let mut series = SwarmSeries::default();
        for (t_s, members, value) in [(0.0, 1.0, 9.0), (2.0, 1.0, 7.0), (4.0, 3.0, 3.0)] {
            series.begin(t_s);
            series.set(Column::Members, members);
            series.set(Column::Rho, value);
        }
        assert_eq!(series.mean_of_members(Column::Rho, 2.0), Some((7.0 + 3.0 * 3.0) / 4.0));
        assert_eq!(series.mean(Column::Rho, 2.0), Some(5.0));
        assert_eq!((series.mean(Column::Order, 0.0), series.mean_of_members(Column::Rho, 5.0)), (None, None));
    }
}
