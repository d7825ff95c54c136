//! The integration of the equations of motion over one tick: the exponential Runge-Kutta method of fourth order of S.
//! Krogstad, "Generalized integrating factor methods for stiff PDEs" (Journal of Computational Physics, 2005).
//!
//! The inflow ratios follow their equilibrium within milliseconds (poles at −84 and −169 1/s in the hover, up to five
//! times that in fast descents), the servos as fast as an aircraft file says, all other states within tens of
//! milliseconds or more. The pole of each inflow ratio is taken from its equation at the beginning of a step, and the
//! method solves that linear part exactly; a pole that is not exact costs accuracy of the inflow and not the order of
//! the method. The servos are linear, and their commands are held: the method is exact for them. For all other states
//! it is the classical fourth-order Runge-Kutta method. A step therefore may be as long as a tick.
//!
//! The skids are stiff too (poles down to −418 1/s): near the ground a step is a quarter of a tick. Which helicopters
//! are near the ground is decided for each by itself at the beginning of the tick.

use super::TICK_S;
use super::dynamics::{Dynamics, ServoCommand, State};
use super::vector::Vector;
use crate::lanes::{Mask, Real};

/// Steps in one tick near the ground.
const STEPS_NEAR_GROUND: u32 = 4;
/// Height of the centre of gravity above the reach of the skids, m, from which on the ground is out of reach for a tick:
/// a helicopter that sinks faster than 100 m/s has left the model's range long before.
const CLEARANCE_M: f64 = 2.0;

/// Number of poles whose states the method solves exactly as far as they are linear: of the servos, and of the inflow
/// ratios of main and tail rotor.
const POLES: usize = 3;
/// Each such state's index, and its pole's: three servos and two inflow ratios.
const FAST: [(usize, usize); 5] = [(18, 0), (19, 0), (20, 0), (21, 1), (22, 2)];
/// Largest product of pole and step length: a faster pole is taken for one of this speed.
const MOST_STIFF: f64 = 16.0;

/// The rates at the stages of one step, after a first entry of zeros.
#[derive(Debug)]
pub(super) struct Stages<R = f64>([State<R>; 5]);

impl<R: Real> Default for Stages<R> {
    fn default() -> Self {
        Self([State::default(); 5])
    }
}

impl<R: Real> Dynamics<R> {
    /// Advances by one tick, with command and wind (NED, m/s) held.
    #[inline(always)]
    pub(super) fn tick(
        &self,
        state: &State<R>,
        command: &ServoCommand<R>,
        wind: Vector<R>,
        stages: &mut Stages<R>,
    ) -> State<R> {
        let near_ground = self.height_above_reach_m(state).lt(R::splat(CLEARANCE_M));
        let mut next = *state;
        for (is_meant, steps) in [(!near_ground, 1), (near_ground, STEPS_NEAR_GROUND)] {
            if is_meant.any() {
                let mut states = [*state; 2];
                for step in 0..steps as usize {
                    let step_s = TICK_S / f64::from(steps);
                    states[(step + 1) % 2] = self.step(step_s, &states[step % 2], command, wind, stages);
                }
                next = State::select(is_meant, &states[steps as usize % 2], &next);
            }
        }
        next
    }

    /// Advances by one step of this length, s, with command and wind (NED, m/s) held.
    #[inline(always)]
    pub(super) fn step(
        &self,
        step_s: f64,
        state: &State<R>,
        command: &ServoCommand<R>,
        wind: Vector<R>,
        Stages(rates): &mut Stages<R>,
    ) -> State<R> {
        let mut exponentials = [Exponential::default(); POLES];
        // A loop over the stages: one copy of the equations in the machine code. Its arrays keep the states of eight
        // vehicles in memory between the stages: in registers, the compiler would take them apart.
        for stage in 0..4 {
            let mut at = state.plus([0.0, 0.5 * step_s, 0.5 * step_s, step_s][stage], &rates[stage]);
            if stage > 0 {
                for (i, pole) in FAST {
                    at.0[i] = exponentials[pole].at(stage, state.0[i], rates[1].0[i], rates[stage].0[i]);
                }
            }
            let (mut now, inflows) = self.rates_and_inflows(&at, command, wind);
            if stage == 0 {
                for (exponential, pole) in exponentials.iter_mut().zip(self.fast_poles(&inflows)) {
                    *exponential = Exponential::new(step_s, pole);
                }
            }
            for (i, pole) in FAST {
                now.0[i] = now.0[i] - exponentials[pole].pole * (at.0[i] - state.0[i]);
            }
            rates[stage + 1] = now;
        }
        let [_, k1, k2, k3, k4] = rates;
        let mut next = state.after(step_s, k1, k2, k3, k4);
        for (i, pole) in FAST {
            next.0[i] = state.0[i] + exponentials[pole].change([k1.0[i], k2.0[i], k3.0[i], k4.0[i]]);
        }
        next.within_bounds()
    }
}

/// The coefficients of Krogstad's method for one state with the equation ẏ = L (y − y₀) + N, in which L is its pole and
/// y₀ its value at the beginning of the step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Exponential<R = f64> {
    /// L, 1/s.
    pole: R,
    /// For each stage, the factors of N₁ and of the difference between the last stage's N and N₁, s.
    first: [R; 4],
    difference: [R; 4],
    /// The factors of N₁, N₂ + N₃ and N₄ in the whole step, s.
    whole: [R; 3],
}

impl<R: Real> Exponential<R> {
    #[inline(always)]
    pub(super) fn new(step_s: f64, pole: R) -> Self {
        let pole = pole.max(R::splat(-MOST_STIFF / step_s));
        // φ1, φ2 and φ3 by their series at z/32, and by doubling from there.
        let mut z = pole * (step_s / 32.0);
        let mut phi3 = R::splat(1.0 / 3_628_800.0);
        for factorial in [362_880.0, 40_320.0, 5_040.0, 720.0, 120.0, 24.0, 6.0] {
            phi3 = phi3 * z + 1.0 / factorial;
        }
        let mut phi2 = phi3 * z + 0.5;
        let mut phi1 = phi2 * z + 1.0;
        let mut half = (phi1, phi2);
        for _ in 0..5 {
            half = (phi1, phi2);
            phi3 = (phi1 * phi2 + phi2 + phi3 * 2.0) * 0.125;
            phi2 = phi1 * phi1 * 0.25 + phi2 * 0.5;
            phi1 = phi1 + z * phi1 * phi1 * 0.5;
            z = z * 2.0;
        }
        let (half1, half2) = (half.0 * (0.5 * step_s), half.1 * step_s);
        let none = R::splat(0.0);
        Self {
            pole,
            first: [none, half1, half1, phi1 * step_s],
            difference: [none, none, half2, phi2 * (2.0 * step_s)],
            whole: [
                (phi1 - phi2 * 3.0 + phi3 * 4.0) * step_s,
                (phi2 * 2.0 - phi3 * 4.0) * step_s,
                (phi3 * 4.0 - phi2) * step_s,
            ],
        }
    }

    /// The state at a stage, from N₁ and the N of the stage before.
    #[inline(always)]
    pub(super) fn at(&self, stage: usize, start: R, first: R, last: R) -> R {
        start + self.first[stage] * first + self.difference[stage] * (last - first)
    }

    /// The change of the state in the whole step.
    #[inline(always)]
    pub(super) fn change(&self, [n1, n2, n3, n4]: [R; 4]) -> R {
        let [first, middle, last] = self.whole;
        first * n1 + middle * (n2 + n3) + last * n4
    }
}
