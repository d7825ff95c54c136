//! One team of a fleet in the air: its world, its figures, and what it exchanges with the other teams.

use std::fs::File;
use std::io::BufWriter;
use std::ops::Range;
use std::path::Path;

use skein_common::frame::{Origin, PositionNed};
use skein_common::id::{FleetVehicle, TeamId, VehicleId, VehicleName};
use skein_common::scenario::{EventAction, Fault, ScriptedEvent};
use skein_common::topic::Cell;
use skein_core::agent::Agent;
use skein_core::impairments::lasting;
use skein_core::neighbourhood::{Homes, Neighbourhood};
use skein_core::plant::GroundTruth;

use super::super::flight::SeedFlight;
use super::super::recorded::RunRecorder;
use super::super::{Study, StudyError};
use super::sky::{Group, Sent, Sky};
use crate::metrics::across::Airborne;
use crate::metrics::{AIRBORNE_ABOVE_M, Report, Run, VehicleTraffic, Wall};
use crate::record::{self, RecordError, RecordingInfo, TeamPlaces, VehiclePlace, Writer, log_time_ns};
use crate::recording::{NotedKind, Watch};

/// A team in the air.
pub(super) struct Team {
    pub(super) id: TeamId,
    /// Origin of its frame.
    origin: Origin,
    pub(super) flight: SeedFlight,
    /// The times in which the team receives nothing from other teams, s after its take-off. The flag states whether the
    /// other teams receive nothing from it either.
    isolated: Vec<(Range<f64>, bool)>,
    /// The states and intents sent in this round.
    pub(super) sent: Sent,
    neighbourhoods: Vec<Neighbourhood>,
    /// The cells of each vehicle at the end of the last round.
    homes: Vec<Homes>,
    pub(super) airborne: Airborne,
    pub(super) received: Received,
    /// Number of messages of other teams that each vehicle received, and their size, bytes.
    from_others: Vec<(u64, u64)>,
    /// Beginning of the window; `None` before it, s.
    zero_s: Option<f64>,
    /// Whether the team's mission has ended, and its figures with it.
    is_over: bool,
    /// Events and faults of this round; `None` if the fleet is not recorded.
    noted: Option<Vec<(f64, NotedKind)>>,
    /// The full recording of the team, and its steps a second, Hz.
    recorder: Option<(RunRecorder, f64)>,
}

/// Counts of the states that the vehicles of a team received in the window.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Received {
    /// States of other teams of all vehicles.
    pub(super) states: u64,
    /// The counts of the vehicles with a vehicle in each of their nine cells: the rounds of all of them, the states of
    /// other teams that they received, and the bytes of these states.
    pub(super) surrounded: (u64, u64, u64),
}

impl Team {
    /// The team of this study, on the ground. `recording` is the folder of the run and the team's complete scenario file.
    ///
    /// # Errors
    /// If the scenario cannot be flown, or the team's recording cannot be begun.
    pub(super) fn new(study: &Study, recording: Option<(&Path, &String)>) -> Result<Self, StudyError> {
        let scenario = &study.scenario;
        let (id, origin) =
            (scenario.team.map_or(TeamId::FIRST, |team| team.id), Origin::new(scenario.origin.geodetic()));
        let chosen = recording.filter(|_| scenario.team.is_some_and(|team| team.is_recorded));
        let recorder = chosen.map(|(folder, scenario_toml)| {
            let path = folder.join("teams").join(id.to_string()).join(record::FILE);
            let about = RecordingInfo { scenario, scenario_toml, run: &Run::new(scenario, "study"), is_fleet: false };
            RunRecorder::begin(&path, &about).map(|file| (file, scenario.record.hz.in_study_hz()))
        });
        let recorder = recorder.transpose()?;
        let flight = SeedFlight::new(study, scenario.seed)?;
        let isolation = |event: &ScriptedEvent| match event.what {
            EventAction::Fault(Fault::Isolate { both_ways }) => Some((lasting(event), both_ways)),
            _ => None,
        };
        Ok(Self {
            id,
            origin,
            flight,
            isolated: scenario.mission.events.iter().filter_map(isolation).collect(),
            sent: Sent::default(),
            neighbourhoods: Vec::new(),
            homes: Vec::new(),
            airborne: Airborne::new(id, origin),
            received: Received::default(),
            from_others: vec![(0, 0); scenario.swarm.vehicles],
            zero_s: None,
            is_over: false,
            noted: recording.map(|_| Vec::new()),
            recorder,
        })
    }

    /// Hands over what the other teams sent in the last round.
    pub(super) fn receive(&mut self, sky: &Sky) {
        self.airborne.clear();
        if self.is_isolated(false) {
            return;
        }
        let from_others = sky.received(&self.origin, &self.homes, self.id);
        for (Group { states, intents, is_surrounded }, (all, all_bytes)) in
            from_others.counts().zip(&mut self.from_others)
        {
            self.received.states += states.0;
            (*all, *all_bytes) = (*all + states.0 + intents.0, *all_bytes + states.1 + intents.1);
            if *is_surrounded {
                let (rounds, all, all_bytes) = &mut self.received.surrounded;
                (*rounds, *all, *all_bytes) = (*rounds + 1, *all + states.0, *all_bytes + states.1);
            }
        }
        self.flight.world.receive_strangers(&from_others.states, &from_others.intents);
    }

    /// Flies one frame and measures it. `fleet` is the origin of the cells, `zero_s` the beginning of the window.
    pub(super) fn tick(&mut self, fleet: &Origin, zero_s: Option<f64>) {
        self.flight.world.tick();
        let is_isolated = self.is_isolated(true);
        let world = &self.flight.world;
        if !is_isolated {
            let at = world.now();
            for state in world.states_in_flight() {
                let id = FleetVehicle { team: self.id, vehicle: state.header.sender };
                self.sent.add([fleet, &self.origin], id, state, at);
            }
            for intent in world.intents() {
                self.sent.add_intent(fleet, self.id, intent, at);
            }
        }
        self.zero_s = zero_s;
        let Some(zero_s) = zero_s else { return };
        let t_s = world.t_s() - zero_s;
        let is_high = |truth: &GroundTruth| truth.height_m > AIRBORNE_ABOVE_M;
        let in_the_air = world.all_vehicles().filter(|(_, _, truth, _)| is_high(truth));
        self.airborne.add(t_s, in_the_air.map(|(id, _, truth, _)| (id, truth.position)));
        if let Some(noted) = &mut self.noted {
            let events = world.events().map(|(sender, what)| NotedKind::Event(sender, what));
            let faults = world.faults().iter().cloned().map(NotedKind::Fault);
            noted.extend(faults.chain(events).map(|what| (t_s, what)));
        }
        if self.is_over {
            return;
        }
        self.flight.zero_s = Some(zero_s);
        let mut watched = self.recorder.as_mut().map(|(file, hz)| (&mut file.writer as &mut dyn Watch, *hz));
        self.flight.end_tick(&mut watched);
        // As in a flight of one swarm, the team's figures end with the frame in which its mission does.
        self.is_over = self.flight.has_finished();
    }

    /// Looks up the cells of the vehicles, by their agents' own estimates; without an estimate a vehicle is where it is.
    /// `fleet` is the origin of the cells.
    pub(super) fn end_round(&mut self, fleet: &Origin) {
        let Self { origin, flight, neighbourhoods, homes, .. } = self;
        let world = &flight.world;
        let on_map = |place| fleet.ned_from_geodetic(&origin.geodetic_from_ned(place));
        neighbourhoods.resize_with(world.vehicle_count(), Neighbourhood::default);
        homes.clear();
        for ((_, agent, truth, _), neighbourhood) in world.all_vehicles().zip(neighbourhoods) {
            let here = on_map(agent.and_then(Agent::position).unwrap_or(truth.position));
            let centre = agent.map(Agent::centre_ne_m).map(|centre| on_map(PositionNed::new(centre.x, centre.y, 0.0)));
            neighbourhood.changed(here, centre.unwrap_or(here), agent.and_then(Agent::wanted_area).map(on_map));
            homes.extend(neighbourhood.homes());
        }
    }

    /// Records the events and faults of the round, and where the vehicles are now. `fleet` is the origin of the fleet's frame.
    pub(super) fn record(&mut self, writer: &mut Writer<BufWriter<File>>, fleet: &Origin, with_places: bool) {
        let Some(zero_s) = self.zero_s else { return };
        for (t_s, what) in self.noted.iter_mut().flat_map(|noted| noted.drain(..)) {
            let (at, team) = (log_time_ns(0, t_s), Some(self.id));
            match what {
                NotedKind::Event(vehicle, what) => writer.event(at, VehicleName { team, vehicle }, None, &what),
                NotedKind::Fault(fault) => writer.fault(at, team, &fault),
            }
        }
        if !with_places {
            return;
        }
        let place = |(id, agent, truth, _): (VehicleId, &Agent, &GroundTruth, _)| {
            let in_fleet = fleet.ned_from_geodetic(&self.origin.geodetic_from_ned(truth.position));
            VehiclePlace::new(id, agent.at_step(), in_fleet, truth.position.altitude_m(), agent.in_place_s().is_some())
        };
        let world = &self.flight.world;
        let vehicles = world.vehicles().filter(|(_, _, truth, _)| truth.position.is_finite()).map(place).collect();
        let t_s = world.t_s() - zero_s;
        writer.places(log_time_ns(0, t_s), &TeamPlaces { team: self.id, t_s, vehicles });
    }

    /// Whether the mission has ended except for the landing, or no agent runs.
    pub(super) fn has_finished(&self) -> bool {
        self.flight.world.has_finished() || self.flight.world.vehicles().next().is_none()
    }

    /// The cells in which the vehicles are.
    pub(super) fn cells(&self) -> impl Iterator<Item = Cell> {
        self.homes.iter().map(|homes| homes.here)
    }

    /// The figures, and whether the recording of the team, which ends here, is complete.
    pub(super) fn report(&mut self, wall: Wall) -> (Report, Result<(), RecordError>) {
        let report = self.flight.figures(wall);
        let recorded = self.recorder.take().map_or(Ok(()), |(file, _)| file.finish(report.duration_s));
        (report, recorded)
    }

    /// Number of messages and bytes that a vehicle received from its own team in a second.
    pub(super) fn own_per_s(&self) -> (f64, f64) {
        let (world, totals) = (&self.flight.world, self.flight.world.totals());
        let (heartbeats, heartbeat_bytes) = world.heartbeats_sent();
        // Each message of a vehicle reaches all others of the team.
        let per_s = |count: u64| {
            let vehicles = world.vehicle_count() as f64;
            count as f64 * (vehicles - 1.0) / vehicles / world.t_s().max(1e-9)
        };
        (per_s(totals.state_messages + heartbeats), per_s(totals.state_bytes + heartbeat_bytes))
    }

    /// The messages that each vehicle received.
    pub(super) fn traffic(&self) -> impl Iterator<Item = VehicleTraffic> {
        let (own_per_s, counted_s) = (self.own_per_s(), self.flight.world.t_s());
        let per_s = move |count: u64| count as f64 / counted_s.max(1e-9);
        let vehicles = self.from_others.iter().zip(VehicleId::first(self.from_others.len()));
        vehicles.map(move |(&(messages, bytes), vehicle)| VehicleTraffic {
            vehicle: FleetVehicle { team: self.id, vehicle }.to_string(),
            counted_s,
            links: None,
            messages_per_s: own_per_s.0 + per_s(messages),
            bytes_per_s: own_per_s.1 + per_s(bytes),
            others_messages_per_s: Some(per_s(messages)),
            others_bytes_per_s: Some(per_s(bytes)),
        })
    }

    /// Whether an event isolates the team now; with `both_ways` only an event that withholds its states from the others.
    fn is_isolated(&self, both_ways: bool) -> bool {
        let is_now = |t_s: f64| self.isolated.iter().any(|(lasts, both)| lasts.contains(&t_s) && (*both || !both_ways));
        !self.isolated.is_empty() && self.flight.world.since_take_off_s().is_some_and(is_now)
    }
}
