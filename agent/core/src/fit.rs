//! Fit: finds trim and gains of an aircraft that was never flown by these rules before, by flying it.
//!
//! [`Fit`] takes one vehicle up a ladder. Each rung tries one thing, measures it, and is the condition of the next:
//!
//! | rung | what it does | stops if |
//! | --- | --- | --- |
//! | [`Rung::Watch`] | waits on the ground until the rotor turns steadily | the vehicle moves, or the rotor does not settle |
//! | [`Rung::Answer`] | moves cyclic and pedals a little, at rising collective | a control does not answer before lift-off |
//! | [`Rung::LiftOff`] | raises the collective until the vehicle lifts off | it does not lift, or tips over |
//! | [`Rung::Hover`] | hovers, and takes the mean controls and attitude as trim | the hover does not settle, or lacks margin |
//! | [`Rung::Respond`] | gives each control a short step and measures the response | a response is implausible |
//! | [`Rung::Check`] | flies 8 m aside and back with the gains found | it overshoots, oscillates, or does not settle |
//! | [`Rung::Land`] | descends and takes the load off | |
//!
//! A vehicle that fails a rung in the air lands with what is known by then. Gains are those that give the vehicle the
//! responses of the built-in helicopter, for which the rules were tuned.
//!
//! It is made for calm air: wind leans the hover, and the lean would become trim.

mod answer;
mod flying;
mod hover;
mod respond;

use alloc::string::String;

use skein_common::frame::Origin;
use skein_common::time::PlantTime;

use crate::control::{Gains, Rules, Trim};
use crate::estimate::Estimate;
use crate::plant::{Controls, Measurement};
use answer::Answering;
use flying::{Flying, Lifting};
use hover::Hovering;
use respond::{Checking, Responding};

/// A rung of the ladder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rung {
    /// Watches the vehicle on the ground.
    Watch,
    /// Finds the direction of each control.
    Answer,
    /// Lifts off.
    LiftOff,
    /// Finds the trim.
    Hover,
    /// Finds the gains.
    Respond,
    /// Flies with them.
    Check,
    /// Lands.
    Land,
}

impl Rung {
    /// The text that describes the rung to the operator.
    pub fn text(self) -> &'static str {
        match self {
            Self::Watch => "waiting for a steady rotor",
            Self::Answer => "trying the controls on the ground",
            Self::LiftOff => "lifting off",
            Self::Hover => "hovering, to find the trim",
            Self::Respond => "measuring the responses",
            Self::Check => "flying aside and back",
            Self::Land => "landing",
        }
    }
}

/// One of the four controls.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Axis {
    /// Lateral cyclic.
    Roll,
    /// Longitudinal cyclic.
    Pitch,
    /// Pedals.
    Yaw,
    /// Collective.
    Collective,
}

impl Axis {
    const ALL: [Self; 4] = [Self::Roll, Self::Pitch, Self::Yaw, Self::Collective];

    /// This control's of four values, one for each control.
    fn of<T>(self, [roll, pitch, yaw, collective]: [T; 4]) -> T {
        match self {
            Self::Roll => roll,
            Self::Pitch => pitch,
            Self::Yaw => yaw,
            Self::Collective => collective,
        }
    }

    fn control(self, controls: &mut Controls) -> &mut f64 {
        self.of([&mut controls.roll, &mut controls.pitch, &mut controls.yaw, &mut controls.collective])
    }

    fn gain(self, gains: &mut Gains) -> &mut f64 {
        self.of([&mut gains.roll, &mut gains.pitch, &mut gains.yaw, &mut gains.collective])
    }

    /// Adds to this control.
    fn move_by(self, controls: &mut Controls, by: f64) {
        let control = self.control(controls);
        let low = if self == Self::Collective { 0.0 } else { -1.0 };
        *control = (*control + by).clamp(low, 1.0);
    }
}

impl core::fmt::Display for Axis {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.of(["roll", "pitch", "yaw", "collective"]))
    }
}

/// The reason why the ladder ended before its top.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    /// Too few measurements.
    #[error("the simulator's data are not usable: {0}")]
    Data(&'static str),
    /// The vehicle did not stand still, level and close to the ground.
    #[error("the vehicle does not stand still and level on the ground; place it on level ground")]
    NotAtRest,
    /// The rotor did not reach a steady speed.
    #[error("the rotor does not turn steadily (last {rpm:.0} rpm): start the engine, and check throttle and governor")]
    Rotor {
        /// The last rotor speed, revolutions per minute.
        rpm: f64,
    },
    /// A control had no effect.
    #[error("{axis} does not answer: check its dataref and the overrides")]
    NoAnswer {
        /// The control.
        axis: Axis,
    },
    /// Full collective does not lift the vehicle.
    #[error("the vehicle does not lift off at full collective: check the collective's dataref, power and weight")]
    NoLift,
    /// The hover needs too much collective.
    #[error("the hover needs a collective of {collective:.2}, which leaves a margin of less than {least:.2}")]
    Margin {
        /// Collective in the hover.
        collective: f64,
        /// The least margin to full collective.
        least: f64,
    },
    /// The hover did not become steady.
    #[error("the hover does not become steady ({0})")]
    NotSettled(String),
    /// A response is against its direction on the ground, or out of proportion.
    #[error(
        "{axis} answers {ratio:.2} times as strongly as the built-in helicopter; only {low} to {high} can be flown"
    )]
    Response {
        /// The control.
        axis: Axis,
        /// Response over that of the built-in helicopter, in the direction found on the ground.
        ratio: f64,
        /// Smallest ratio.
        low: f64,
        /// Largest ratio.
        high: f64,
    },
    /// The flight with the gains found was not good enough.
    #[error("with the gains found, {what} is {value:.2}, but has to be at most {limit:.2}")]
    Check {
        /// The figure with its unit.
        what: &'static str,
        /// Its value.
        value: f64,
        /// Its limit.
        limit: f64,
    },
    /// A limit of safe flight was exceeded.
    #[error("{0}")]
    Unsafe(&'static str),
    /// The person who watches stopped it.
    #[error("stopped on request")]
    Stopped,
}

/// Responses of a vehicle per full control: what the gains make equal.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Responses {
    /// Roll rate, rad/s.
    pub roll_rad_s: f64,
    /// Pitch rate, rad/s.
    pub pitch_rad_s: f64,
    /// Yaw rate, rad/s.
    pub yaw_rad_s: f64,
    /// Climb rate one second after a step, m/s.
    pub climb_m_s: f64,
}

/// The results of a fit, as far as its rungs have come.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Fitted {
    /// Controls and attitude of the hover.
    pub trim: Trim,
    /// Factors on the rules' output.
    pub gains: Gains,
    /// Rotor speed in flight, rad/s, if the plant reports it.
    pub rotor_speed_rad_s: Option<f64>,
    /// The responses as measured, signed.
    pub responses: Responses,
    /// Largest overshoot of the two flights aside, share of the distance.
    pub overshoot: f64,
    /// Longer time of the two until the vehicle stayed within 0.5 m of its goal, s.
    pub settled_s: f64,
    /// Height of the centre of gravity while standing, m.
    pub standing_m: f64,
    /// Heading to be held in the air, clockwise from north, rad.
    pub heading_rad: f64,
}

/// The result of one step.
#[derive(Clone, Debug, PartialEq)]
pub struct FitStep {
    /// The controls to command.
    pub controls: Controls,
    /// The rung that gave them.
    pub rung: Rung,
    /// The end: what was found, or why nothing was. The vehicle is on the ground.
    pub end: Option<Result<Fitted, FitError>>,
}

/// One climb of the ladder. Feed it every frame's measurement.
#[derive(Clone, Debug)]
pub struct Fit {
    rules: Rules,
    origin: Option<Origin>,
    /// Last measurement's time, and controls.
    last: Option<(PlantTime, Controls)>,
    found: Fitted,
    stage: Stage,
    /// The reason why the vehicle lands early.
    failure: Option<FitError>,
}

#[derive(Clone, Debug)]
enum Stage {
    Watching(Watching),
    Answering(Answering),
    Lifting(Lifting),
    Hovering(Hovering),
    Responding(Responding),
    Checking(Checking),
    Landing(Flying),
    /// On the ground after the end.
    Standing,
}

/// The result of one step of a stage.
enum Verdict {
    /// It continues with these controls.
    Goes(Controls),
    /// It is done; the next stage begins with the next measurement, and these controls are held until then.
    Done(Controls),
    /// It failed.
    Fails(FitError),
}

/// Time that the vehicle is watched on the ground, s, and how long the rotor may take to get up to speed.
const WATCH_S: f64 = 3.0;
const ROTOR_WITHIN_S: f64 = 120.0;
/// Rotor speed below which a rotor counts as stopped, rad/s, and the share by which a steady one may vary.
const TURNS_FROM_RAD_S: f64 = 5.0;
const STEADY_SHARE: f64 = 0.02;
/// Fewest measurements a second with which a vehicle may be flown.
const LEAST_RATE_HZ: f64 = 20.0;
/// Limits of a vehicle at rest.
const REST_M_S: f64 = 0.3;
const REST_TILT_RAD: f64 = 0.17;

/// Watches the vehicle on the ground.
#[derive(Clone, Debug, Default)]
struct Watching {
    began: Option<PlantTime>,
    /// Since when the rotor has been steady, and at which speed, rad/s.
    steady: Option<(PlantTime, f64)>,
    /// Measurements since then.
    count: u32,
}

impl Watching {
    fn step(&mut self, at: PlantTime, estimate: &Estimate, found: &mut Fitted) -> Verdict {
        let began = *self.began.get_or_insert(at);
        let tilt_rad = estimate.attitude.roll_rad.abs().max(estimate.attitude.pitch_rad.abs());
        let speed_rad_s = estimate.rotor_speed_rad_s;
        let is_slow = speed_rad_s.is_some_and(|speed_rad_s| speed_rad_s < TURNS_FROM_RAD_S);
        let steady = self.steady.get_or_insert((at, speed_rad_s.unwrap_or_default()));
        let changed = speed_rad_s.is_some_and(|speed| (speed - steady.1).abs() > STEADY_SHARE * steady.1.abs());
        self.count += 1;
        if is_slow || changed {
            *steady = (at, speed_rad_s.unwrap_or_default());
            self.count = 0;
        }
        if at.seconds_since(steady.0) < WATCH_S {
            if at.seconds_since(began) > ROTOR_WITHIN_S {
                let rpm = speed_rad_s.unwrap_or_default() * 30.0 / core::f64::consts::PI;
                return Verdict::Fails(FitError::Rotor { rpm });
            }
            return Verdict::Goes(Controls::default());
        }
        if f64::from(self.count) < LEAST_RATE_HZ * WATCH_S {
            return Verdict::Fails(FitError::Data("fewer than 20 measurements a second"));
        }
        if estimate.velocity.0.norm() > REST_M_S || tilt_rad > REST_TILT_RAD {
            return Verdict::Fails(FitError::NotAtRest);
        }
        found.rotor_speed_rad_s = speed_rad_s;
        found.standing_m = estimate.height_m;
        found.heading_rad = estimate.attitude.heading_rad;
        found.trim.roll_rad = estimate.attitude.roll_rad;
        found.trim.pitch_rad = estimate.attitude.pitch_rad;
        Verdict::Done(Controls::default())
    }
}

impl Fit {
    /// A ladder for a vehicle on the ground, flown by these rules.
    pub fn new(rules: Rules) -> Self {
        Self {
            rules,
            origin: None,
            last: None,
            found: Fitted::default(),
            stage: Stage::Watching(Watching::default()),
            failure: None,
        }
    }

    /// Lands, or stops at once on the ground: for a person who wants an end.
    pub fn stop(&mut self) {
        self.fail(FitError::Stopped);
    }

    /// The next controls, for the measurement of one frame.
    pub fn step(&mut self, at: PlantTime, measurement: &Measurement) -> FitStep {
        let (before, last) = self.last.unwrap_or((at, Controls::default()));
        let dt_s = at.seconds_since(before);
        let Some(estimate) = self.estimate(measurement).filter(|_| dt_s >= 0.0) else {
            // Holds the controls for this frame; the caller ends a fit whose data stay away.
            return FitStep { controls: last, rung: self.rung(), end: None };
        };
        let verdict = self.verdict(at, dt_s, &estimate);
        let rung = self.rung();
        let controls = match verdict {
            Verdict::Goes(controls) => controls,
            Verdict::Done(controls) => {
                self.advance(&estimate);
                controls
            }
            Verdict::Fails(error) => {
                self.fail(error);
                if matches!(self.stage, Stage::Standing) { Controls::default() } else { last }
            }
        };
        self.last = Some((at, controls));
        let end = matches!(self.stage, Stage::Standing).then(|| self.end());
        FitStep { controls, rung, end }
    }

    /// The rung that the ladder is on.
    pub fn rung(&self) -> Rung {
        match self.stage {
            Stage::Watching(_) => Rung::Watch,
            Stage::Answering(_) => Rung::Answer,
            Stage::Lifting(_) => Rung::LiftOff,
            Stage::Hovering(_) => Rung::Hover,
            Stage::Responding(_) => Rung::Respond,
            Stage::Checking(_) => Rung::Check,
            Stage::Landing(_) | Stage::Standing => Rung::Land,
        }
    }

    fn verdict(&mut self, at: PlantTime, dt_s: f64, estimate: &Estimate) -> Verdict {
        let found = &mut self.found;
        if self.failure.is_none()
            && let Some(reason) = self.stage.danger(estimate, found)
        {
            return Verdict::Fails(FitError::Unsafe(reason));
        }
        match &mut self.stage {
            Stage::Watching(watching) => watching.step(at, estimate, found),
            Stage::Answering(answering) => answering.step(dt_s, estimate, found),
            Stage::Lifting(lifting) => lifting.step(dt_s, estimate, found),
            Stage::Hovering(hovering) => hovering.step(dt_s, estimate, found),
            Stage::Responding(responding) => responding.step(dt_s, estimate, found),
            Stage::Checking(checking) => checking.step(dt_s, estimate, found),
            Stage::Landing(flying) => flying.land(dt_s, estimate, found),
            Stage::Standing => Verdict::Goes(Controls::default()),
        }
    }

    /// Begins the next stage.
    fn advance(&mut self, estimate: &Estimate) {
        let place_ne_m = estimate.position.horizontal();
        let flying = |found: &Fitted, rules: &Rules| Flying::new(rules.clone(), found, estimate);
        self.stage = match &self.stage {
            Stage::Watching(_) => Stage::Answering(Answering::default()),
            Stage::Answering(answering) => {
                Stage::Lifting(Lifting::new(flying(&self.found, &self.rules), answering.collective))
            }
            Stage::Lifting(_) => Stage::Hovering(Hovering::new(flying(&self.found, &self.rules))),
            Stage::Hovering(_) => Stage::Responding(Responding::new(flying(&self.found, &self.rules))),
            Stage::Responding(_) => Stage::Checking(Checking::new(flying(&self.found, &self.rules), place_ne_m)),
            Stage::Checking(_) => Stage::Landing(flying(&self.found, &self.rules)),
            Stage::Landing(_) | Stage::Standing => Stage::Standing,
        };
    }

    /// Keeps the first failure and ends as safely as the stage allows.
    fn fail(&mut self, error: FitError) {
        self.failure.get_or_insert(error);
        self.stage = match core::mem::replace(&mut self.stage, Stage::Standing) {
            Stage::Watching(_) | Stage::Answering(_) | Stage::Standing => Stage::Standing,
            Stage::Lifting(Lifting { flying, .. })
            | Stage::Hovering(Hovering { flying, .. })
            | Stage::Responding(Responding { flying, .. })
            | Stage::Checking(Checking { flying, .. })
            | Stage::Landing(flying) => Stage::Landing(flying),
        };
    }

    fn end(&self) -> Result<Fitted, FitError> {
        self.failure.clone().map_or(Ok(self.found), Err)
    }

    /// The estimate in a frame whose origin is the first position; `None` if a number is not finite.
    fn estimate(&mut self, measurement: &Measurement) -> Option<Estimate> {
        let Measurement { position, height_m, velocity, attitude, rates, .. } = measurement;
        let is_finite = height_m.is_finite() && velocity.is_finite() && attitude.is_finite() && rates.is_finite();
        if !(position.is_plausible() && is_finite) {
            return None;
        }
        let origin = self.origin.get_or_insert_with(|| Origin::new(*position));
        let estimate = Estimate::of(measurement, origin);
        let rotor_speed_rad_s = estimate.rotor_speed_rad_s.filter(|speed| speed.is_finite());
        Some(Estimate { rotor_speed_rad_s, ..estimate })
    }
}

/// Tilt from which a flight is not safe any more, rad, and distance from the start, and height, m.
const LARGEST_TILT_RAD: f64 = 0.7;
const FARTHEST_M: f64 = 40.0;
const HIGHEST_M: f64 = 25.0;
/// Share of the rotor's speed below which it carries the vehicle no longer.
const LEAST_ROTOR_SHARE: f64 = 0.75;
/// Tilt on the ground from which a vehicle begins to tip over, rad.
const TIPS_FROM_RAD: f64 = 0.2;

impl Stage {
    /// Whether the vehicle is beyond the limits of this stage.
    fn danger(&self, estimate: &Estimate, found: &Fitted) -> Option<&'static str> {
        let tilt_rad = estimate.attitude.roll_rad.abs().max(estimate.attitude.pitch_rad.abs());
        match self {
            Self::Watching(_) | Self::Landing(_) | Self::Standing => None,
            Self::Answering(_) => (tilt_rad > TIPS_FROM_RAD).then_some("the vehicle begins to tip over on the ground"),
            _ => {
                let is_slow = estimate
                    .rotor_speed_rad_s
                    .zip(found.rotor_speed_rad_s)
                    .is_some_and(|(now, before)| now < LEAST_ROTOR_SHARE * before);
                [
                    (tilt_rad > LARGEST_TILT_RAD, "the vehicle leans too far"),
                    (estimate.position.horizontal().norm() > FARTHEST_M, "the vehicle drifts too far from its start"),
                    (estimate.height_m > found.standing_m + HIGHEST_M, "the vehicle climbs too high"),
                    (is_slow, "the rotor slows down: it lacks power"),
                ]
                .into_iter()
                .find_map(|(is_so, reason)| is_so.then_some(reason))
            }
        }
    }
}

/// The mean of numbers.
#[derive(Clone, Copy, Debug, Default)]
struct Mean {
    sum: f64,
    count: u32,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1;
    }

    /// The mean; 0 of nothing.
    fn get(&self) -> f64 {
        self.sum / f64::from(self.count.max(1))
    }
}

#[cfg(test)]
mod tests;
