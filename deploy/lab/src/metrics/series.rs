//! Accumulators for the samples of a run.

use std::collections::VecDeque;

use skein_common::id::{VehicleId, VehicleSet};

use super::STEADY_S;

/// Finds the first time after which a condition holds to the end.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Settling {
    since_s: Option<f64>,
}

impl Settling {
    pub(super) fn observe(&mut self, t_s: f64, holds: bool) {
        self.since_s = if holds { self.since_s.or(Some(t_s)) } else { None };
    }

    pub(super) fn since_s(&self) -> Option<f64> {
        self.since_s
    }
}

/// The longest of several delays; a reaction that never came ranks above all.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Worst {
    longest_s: Option<f64>,
    is_never: bool,
}

impl Worst {
    /// Adds a reaction that came after this delay, s.
    pub(super) fn add_time(&mut self, took_s: f64) {
        self.longest_s = Some(self.longest_s.map_or(took_s, |longest_s| longest_s.max(took_s)));
    }

    /// Adds a reaction that had enough time and never came.
    pub(super) fn add_never(&mut self) {
        self.is_never = true;
    }

    /// Longest delay, s; `None` if a reaction never came.
    pub(super) fn s(&self) -> Option<f64> {
        self.longest_s.filter(|_| !self.is_never)
    }

    /// Whether a reaction never came.
    pub(super) fn is_never(&self) -> bool {
        self.is_never
    }
}

/// A running mean.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Mean {
    sum: f64,
    count: u64,
}

impl Mean {
    pub(super) fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1;
    }

    /// Number of values.
    pub(super) fn count(&self) -> u64 {
        self.count
    }

    pub(super) fn mean(&self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }
}

/// The samples of a value over the last [`STEADY_S`].
#[derive(Clone, Debug, Default)]
pub(super) struct Window {
    samples: VecDeque<(f64, f64)>,
}

impl Window {
    pub(super) fn add(&mut self, t_s: f64, value: f64) {
        drop_before(&mut self.samples, t_s - STEADY_S, |sample| sample.0);
        self.samples.push_back((t_s, value));
    }

    /// Mean of the values since `since_s`; `None` without values.
    pub(super) fn mean(&self, since_s: f64) -> Option<f64> {
        mean(self.samples.iter().filter(|sample| sample.0 >= since_s).map(|sample| sample.1))
    }
}

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
#[derive(Clone, Debug)]
pub(super) struct SwarmSeries {
    rows: VecDeque<Row>,
    /// Every how many instants values are kept, and the instants to the next of them.
    every: u32,
    to_next: u32,
}

#[derive(Clone, Copy, Debug)]
struct Row {
    t_s: f64,
    /// Not a number where a value does not exist.
    values: [f64; COLUMNS],
}

/// Largest number of rows for which memory is reserved at once.
const LARGEST_RESERVE: f64 = 10_000.0;

impl SwarmSeries {
    /// A series that keeps the values of every `every`-th instant.
    pub(super) fn new(every: u32) -> Self {
        Self { rows: VecDeque::new(), every, to_next: 0 }
    }

    /// Begins the next instant, without values. Returns whether its values are kept.
    pub(super) fn begin(&mut self, t_s: f64) -> bool {
        self.to_next = if self.to_next == 0 { self.every } else { self.to_next } - 1;
        if !self.is_kept() {
            return false;
        }
        drop_before(&mut self.rows, t_s - STEADY_S, |row| row.t_s);
        if let (Some(last), true) = (self.rows.back(), self.rows.len() == self.rows.capacity()) {
            // Room for a whole window, and not twice as much.
            let window = (STEADY_S / (t_s - last.t_s)).min(LARGEST_RESERVE) as usize + 8;
            self.rows.reserve_exact(window.saturating_sub(self.rows.len()));
        }
        self.rows.push_back(Row { t_s, values: [f64::NAN; COLUMNS] });
        true
    }

    /// Whether the values of this instant are kept.
    fn is_kept(&self) -> bool {
        self.to_next == self.every - 1
    }

    /// Sets a value at this instant.
    pub(super) fn set(&mut self, column: Column, value: f64) {
        if self.is_kept()
            && let Some(row) = self.rows.back_mut()
        {
            row.values[column as usize] = value;
        }
    }

    /// The rows since `since_s`.
    fn since(&self, since_s: f64) -> impl Iterator<Item = &[f64; COLUMNS]> {
        self.rows.iter().filter(move |row| row.t_s >= since_s).map(|row| &row.values)
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

/// Where each vehicle was in its formation over the last [`STEADY_S`], a byte for each sample.
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
    /// Where each sample is between the two, in parts of [`LARGEST_CODE`], or [`NO_SAMPLE`].
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
pub(super) struct InFormation {
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
    pub(super) fn figures(&self, vehicle: usize, since_s: f64) -> Option<InFormation> {
        let samples: Vec<_> = self.samples(vehicle, since_s).collect();
        let square = mean(samples.iter().map(|(_, rho_m, radius_m)| (rho_m - radius_m) * (rho_m - radius_m)))?;
        let rho_m = mean(samples.iter().map(|(_, rho_m, _)| *rho_m))?;
        Some(InFormation { error_rms_m: square.sqrt(), rho_m, oscillation_m: oscillation_m(&samples) })
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

fn drop_before<T>(samples: &mut VecDeque<T>, first_s: f64, time_s: impl Fn(&T) -> f64) {
    while samples.front().is_some_and(|sample| time_s(sample) < first_s) {
        samples.pop_front();
    }
}

/// Chooses the peers of which ages are sampled: four at most at each step, one in a swarm of more than 28, each of them again
/// after a number of steps that is a prime. Two states of a vehicle are ten steps apart or another number that the prime does not divide, so that all
/// ages occur in turn.
#[derive(Clone, Debug)]
pub(super) struct AgeSampling {
    groups: Vec<VehicleSet>,
    now: usize,
}

/// Numbers of steps between two samples of one peer's age, all primes: the first for swarms of up to
/// [`LARGEST_SMALL_SWARM`], the least that is not below the number of vehicles for larger ones.
const SAMPLING_STEPS: [usize; 8] = [7, 29, 43, 61, 89, 127, 179, 251];
const LARGEST_SMALL_SWARM: usize = 28;

impl AgeSampling {
    pub(super) fn new(vehicles: usize) -> Self {
        let is_enough = |steps: &usize| *steps >= vehicles || vehicles <= LARGEST_SMALL_SWARM;
        let steps = SAMPLING_STEPS.into_iter().find(is_enough).unwrap_or(SAMPLING_STEPS[SAMPLING_STEPS.len() - 1]);
        let group = |nth| VehicleId::first(vehicles).skip(nth).step_by(steps).collect();
        Self { groups: (0..steps).map(group).collect(), now: 0 }
    }

    /// The peers of which the age is sampled at this step.
    pub(super) fn now(&self) -> VehicleSet {
        self.groups[self.now]
    }

    pub(super) fn next_step(&mut self) {
        self.now = (self.now + 1) % self.groups.len();
    }
}

/// A histogram of ages in bins of 1 ms: its result is independent of the order of samples, and its size of their
/// number.
#[derive(Clone, Debug)]
pub(super) struct AgeHistogram {
    bins: Vec<u64>,
}

/// Age from which on all samples count as equal, ms.
const LARGEST_AGE_MS: usize = 10_000;

impl Default for AgeHistogram {
    fn default() -> Self {
        Self { bins: vec![0; LARGEST_AGE_MS + 1] }
    }
}

impl AgeHistogram {
    pub(super) fn add(&mut self, age_s: f64) {
        self.bins[bin(age_s * 1e3)] += 1;
    }

    /// Age below which this share of the samples lies, ms, by the definition of [`skein_common::statistics::quantile`].
    pub(super) fn quantile_ms(&self, share: f64) -> Option<f64> {
        let count: u64 = self.bins.iter().sum();
        let place = share * count.checked_sub(1)? as f64;
        let (low, high) = (self.sample_ms(place.floor() as u64)?, self.sample_ms(place.ceil() as u64)?);
        Some(low + (high - low) * (place - place.floor()))
    }

    /// The sample of this rank, counted from 0, ms.
    fn sample_ms(&self, rank: u64) -> Option<f64> {
        let mut below = 0;
        let bin = self.bins.iter().position(|samples| {
            below += samples;
            below > rank
        })?;
        Some(bin as f64)
    }
}

/// The bin of an age: the nearest whole number of milliseconds, half a millisecond rounded up, as `round` does it with a
/// call of the C library.
fn bin(age_ms: f64) -> usize {
    let age_ms = age_ms.clamp(0.0, LARGEST_AGE_MS as f64);
    let whole = age_ms as i32;
    whole as usize + usize::from(age_ms - f64::from(whole) >= 0.5)
}

/// Mean of the values; `None` without values.
pub(super) fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut mean = Mean::default();
    values.for_each(|value| mean.add(value));
    mean.mean()
}

/// Least and largest of the values; `None` without values.
pub(super) fn extremes<T: PartialOrd + Copy>(values: impl Iterator<Item = T>) -> Option<(T, T)> {
    values.fold(None, |extremes, value| match extremes {
        None => Some((value, value)),
        Some((low, high)) => Some((if value < low { value } else { low }, if value > high { value } else { high })),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ages_fall_into_the_nearest_bin() {
        for (age_ms, expected) in [
            (-7.0, 0),
            (-0.4, 0),
            (0.499_999_999_999_999_94, 0),
            (0.5, 1),
            (1.5, 2),
            (20.499_999, 20),
            (9_999.5, 10_000),
            (1e12, 10_000),
            (f64::NAN, 0),
        ] {
            assert_eq!(bin(age_ms), expected, "{age_ms}");
        }
    }
}
