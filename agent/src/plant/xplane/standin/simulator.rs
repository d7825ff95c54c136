//! The simulator of a stand-in without sockets and clock: the caller carries the datagrams and keeps the pace.

use std::collections::VecDeque;
use std::net::SocketAddr;

use rand_chacha::ChaCha8Rng;
use skein_common::frame::{Attitude, BodyRates, Geodetic, Origin, PositionNed, VelocityNed, wrap_rad};

use super::options::{StandinError, StandinOptions, check_frames, parameters, start, weather};
use crate::plant::xplane::server::{Order, Server, Surroundings, Task};
use crate::plant::xplane::wire::aircraft::{Move, VEHX};
use crate::plant::xplane::wire::prel::Placement;
use skein_core::helicopter::{BuiltInVehicle, Parameters, Start, TICK_S, Weather};
use skein_core::plant::{Controls, Frame, GroundTruth, Measurement};
use skein_core::random::{Purpose, generator, uniform};

/// Time before the newest frame that a replay covers, s.
const REPLAY_S: f64 = 10.0;
/// Share of a tick below which a rest is a rounding error.
const NEGLIGIBLE_TICKS: f64 = 1e-9;

/// Whether a simulator runs its frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunState {
    /// It runs the frame.
    Running,
    /// It hangs: datagrams wait.
    Frozen,
    /// It has ended: datagrams are lost, and it starts anew afterwards.
    Gone,
}

/// A simulator with one helicopter. In each frame the caller asks for [`Self::begin_frame`], hands over the datagrams
/// received since the last one ([`Self::receive`]) and ends the frame ([`Self::end_frame`]).
pub struct Simulator {
    options: StandinOptions,
    parameters: Parameters,
    weather: Weather,
    /// Place and heading, rad, to which a reset returns.
    start: (Geodetic, f64),
    aircraft: Aircraft,
    /// The server, which knows the subscribers.
    pub server: Server,
    random: ChaCha8Rng,
    /// The pose in which a client holds it, and since when, s.
    held: Option<(Move, f64)>,
    /// Whether it runs its frames, and the time for which it still does not, s.
    state: (RunState, f64),
    /// Number of times that it has been started.
    pub starts: u64,
}

impl Simulator {
    /// A simulator that has just started, with its helicopter at rest on the ground.
    ///
    /// # Errors
    /// If an option is outside its range, or the aircraft file is not valid.
    pub fn new(options: &StandinOptions) -> Result<Self, StandinError> {
        check_frames(options)?;
        let weather = weather(options)?;
        let parameters = parameters(options)?;
        let start = start(options)?;
        Ok(Self {
            aircraft: Aircraft::new(vehicle(options, &parameters, &weather, start)),
            server: server(options, &weather),
            random: generator(options.seed, Some(options.id), Purpose::Simulator),
            held: None,
            state: (RunState::Running, 0.0),
            starts: 1,
            options: options.clone(),
            parameters,
            weather,
            start,
        })
    }

    /// The true state of the helicopter.
    pub fn truth(&self) -> Frame {
        let own = self.aircraft.frame();
        self.held.map_or(own, |(moved, held_s)| self.held_frame(own, &moved, held_s))
    }

    /// The frame of an aircraft that a client holds in a pose: it has no speed there.
    fn held_frame(&self, own: Frame, moved: &Move, held_s: f64) -> Frame {
        let position = Geodetic::from_degrees(moved.latitude_deg, moved.longitude_deg, moved.elevation_m);
        let attitude = Attitude {
            roll_rad: f64::from(moved.roll_deg).to_radians(),
            pitch_rad: f64::from(moved.pitch_deg).to_radians(),
            heading_rad: wrap_rad(f64::from(moved.heading_deg).to_radians()),
        };
        let height_m = moved.elevation_m - self.options.alt_m;
        let velocity = VelocityNed::default();
        let (place, _) = Origin::new(self.start.0).locate(&position);
        let rates = BodyRates::default();
        Frame {
            time: own.time.plus_seconds(held_s),
            measurement: Measurement { position, height_m, velocity, attitude, rates, ..own.measurement },
            truth: GroundTruth { position: place, height_m, velocity, attitude, power_w: None },
        }
    }

    /// Lets the flight model continue from a place, with a heading. The built-in helicopter begins on the ground only.
    fn put_down(&mut self, latitude_deg: f64, longitude_deg: f64, heading_deg: f64) {
        let place = Geodetic::from_degrees(latitude_deg, longitude_deg, self.options.alt_m);
        self.begin_at((place, heading_deg.to_radians()));
    }

    fn begin_at(&mut self, start: (Geodetic, f64)) {
        self.held = None;
        self.aircraft = Aircraft::new(vehicle(&self.options, &self.parameters, &self.weather, start));
    }

    /// Begins a frame: its length, s, and whether it takes place.
    pub fn begin_frame(&mut self) -> (f64, RunState) {
        let deviation = self.options.jitter * (2.0 * uniform(&mut self.random) - 1.0);
        let frame_s = (1.0 + deviation) / f64::from(self.options.rate);
        let (state, left_s) = self.state;
        let is_over = state == RunState::Running || left_s <= frame_s;
        self.state = if is_over { (RunState::Running, 0.0) } else { (state, left_s - frame_s) };
        (frame_s, state)
    }

    /// Processes a datagram; returns whether the simulator can take another one in this frame.
    pub fn receive(&mut self, datagram: &[u8], from: SocketAddr) -> bool {
        if self.is_lost() {
            return true;
        }
        let order = self.server.handle(datagram, from);
        self.obey(order)
    }

    /// Carries a task of the Web API out; the values read. `None` before the first frame.
    pub fn serve(&mut self, task: &Task) -> Option<Vec<serde_json::Value>> {
        let (values, orders) = self.server.serve(task)?;
        for order in orders {
            self.obey(Some(order));
        }
        Some(values)
    }

    /// Does what a message asks for; returns whether it can take another one in this frame.
    fn obey(&mut self, order: Option<Order>) -> bool {
        match order {
            Some(Order::Place(Placement { latitude_deg, longitude_deg, heading_deg, .. })) => {
                self.put_down(latitude_deg, longitude_deg, heading_deg);
            }
            Some(Order::Move(moved)) if moved.tag == VEHX => {
                self.held = Some((moved, self.held.map_or(0.0, |(_, held_s)| held_s)));
            }
            Some(Order::Move(Move { latitude_deg, longitude_deg, heading_deg, .. })) => {
                self.put_down(latitude_deg, longitude_deg, heading_deg.into());
            }
            Some(Order::Reset) => self.begin_at(self.start),
            Some(Order::Freeze(seconds)) => self.state = (RunState::Frozen, seconds.into()),
            Some(Order::Restart(seconds)) => {
                self.starts += 1;
                self.server = server(&self.options, &self.weather);
                self.begin_at(self.start);
                self.state = (RunState::Gone, seconds.into());
                return false;
            }
            None => {}
        }
        true
    }

    /// Ends a frame of this length: moves the helicopter and passes each datagram that is due to `send`.
    pub fn end_frame(&mut self, frame_s: f64, mut send: impl FnMut(SocketAddr, &[u8])) {
        if let Some(weather) = self.server.take_weather() {
            self.weather = weather;
            self.aircraft.vehicle.set_weather(&weather);
        }
        let controls = self.server.take_controls();
        let simulated_s = self.server.simulated_s(frame_s);
        match &mut self.held {
            Some((moved, _)) if !self.server.holds_own() => {
                let Move { latitude_deg, longitude_deg, heading_deg, .. } = *moved;
                self.put_down(latitude_deg, longitude_deg, heading_deg.into());
            }
            Some((_, held_s)) => *held_s += simulated_s,
            None if simulated_s > 0.0 && !self.server.has_crashed() => self.aircraft.advance(controls, simulated_s),
            None => {}
        }
        let shown = if self.server.is_in_replay() { self.aircraft.replay() } else { self.truth() };
        let drop_share = self.server.drop_share();
        let Self { server, random, .. } = self;
        server.publish(&shown, frame_s, |to, datagram| {
            if drop_share <= 0.0 || uniform(random) >= drop_share {
                send(to, datagram);
            }
        });
    }

    fn is_lost(&mut self) -> bool {
        let share = self.server.drop_share();
        share > 0.0 && uniform(&mut self.random) < share
    }
}

/// The helicopter at rest at this place, with this heading, rad.
fn vehicle(
    options: &StandinOptions,
    parameters: &Parameters,
    weather: &Weather,
    (place, heading_rad): (Geodetic, f64),
) -> BuiltInVehicle {
    let start = Start { heading_rad, ..Start::default() };
    BuiltInVehicle::new(&Origin::new(place), parameters, &start, weather, options.seed, options.id)
}

/// A simulator that has just started.
fn server(options: &StandinOptions, weather: &Weather) -> Server {
    let surroundings = Surroundings { acf: options.acf.as_str().into(), weather: *weather };
    let mut server = Server::new(options.version, options.rate, surroundings);
    server.set_drop_share(options.drop);
    server
}

/// The helicopter, what is left to simulate of the last frame, and the last ten seconds.
struct Aircraft {
    vehicle: BuiltInVehicle,
    /// Simulated time beyond the vehicle's last tick, in ticks, below one.
    rest: f64,
    past: VecDeque<Frame>,
    /// The frame of the past that a replay shows next.
    replayed: usize,
}

impl Aircraft {
    fn new(vehicle: BuiltInVehicle) -> Self {
        Self { vehicle, rest: 0.0, past: VecDeque::new(), replayed: 0 }
    }

    /// Advances by the simulated time, s, in whole ticks of the model; the rest is kept for the next frame.
    fn advance(&mut self, controls: Option<Controls>, simulated_s: f64) {
        let ticks = self.rest + simulated_s / TICK_S;
        let whole = (ticks + NEGLIGIBLE_TICKS).floor();
        self.rest = (ticks - whole).max(0.0);
        for _ in 0..whole as u32 {
            self.vehicle.advance(controls);
        }
        self.replayed = 0;
        let newest = self.frame();
        self.past.push_back(newest);
        while self.past.front().is_some_and(|oldest| oldest.time.seconds() < newest.time.seconds() - REPLAY_S) {
            self.past.pop_front();
        }
    }

    /// The state now. Between two ticks the helicopter moves and turns at its last rates: X-Plane simulates every frame,
    /// so that a repeated state would be a fault that no client of X-Plane sees.
    fn frame(&self) -> Frame {
        let frame = self.vehicle.frame();
        let beyond_s = self.rest * TICK_S;
        if self.rest < NEGLIGIBLE_TICKS {
            return frame;
        }
        let mut measurement = frame.measurement;
        let (velocity, rates) = (measurement.velocity, measurement.rates);
        let moved = PositionNed(velocity.0 * beyond_s);
        measurement.position = Origin::new(measurement.position).geodetic_from_ned(moved);
        measurement.height_m -= moved.down_m();
        let Attitude { roll_rad, pitch_rad, heading_rad } = measurement.attitude;
        measurement.attitude = Attitude {
            roll_rad: wrap_rad(roll_rad + rates.roll_rad_s * beyond_s),
            pitch_rad: pitch_rad + rates.pitch_rad_s * beyond_s,
            heading_rad: wrap_rad(heading_rad + rates.yaw_rad_s * beyond_s),
        };
        Frame { time: frame.time.plus_seconds(beyond_s), measurement, ..frame }
    }

    /// The next frame of a replay of the last ten seconds, from the oldest one on and again.
    fn replay(&mut self) -> Frame {
        let shown = self.past.get(self.replayed).copied().unwrap_or_else(|| self.frame());
        self.replayed = if self.replayed + 1 < self.past.len() { self.replayed + 1 } else { 0 };
        shown
    }
}
