//! Records a live fleet: places at the fleet's own rate, events and faults of all teams.

use std::path::Path;
use std::time::{Duration, Instant};

use skein_common::frame::Origin;
use skein_common::id::{TeamId, VehicleId, VehicleName};
use skein_common::message::{EventKind, Message as _, Trace};
use skein_common::scenario::{Described, Scenario};
use skein_lab::error::Error;
use skein_lab::faults::InjectedFault;
use skein_lab::metrics::Run;
use skein_lab::record::{RecordingInfo, TeamPlaces, VehiclePlace};

use super::Recorder;

/// Records a fleet until it is finished.
pub struct FleetRecorder {
    /// The recording.
    pub file: Recorder,
    /// Origin of the fleet's frame.
    origin: Origin,
    period: Duration,
    /// Beginning of the window, and the time of the next places; `None` before it.
    window: Option<(Instant, Instant)>,
    /// Number of times at which places were recorded.
    pub samples: u64,
}

impl FleetRecorder {
    /// Creates the recording of this fleet at `path`.
    ///
    /// # Errors
    /// If the file exists already or cannot be written, or `described` is not a fleet.
    pub fn begin(path: &Path, described: &Described) -> Result<Self, Error> {
        let scenario = &described.first().scenario;
        let team = scenario.team.ok_or_else(|| Error::Refused("one swarm is not a fleet".to_owned()))?;
        let run = Run::of_all(described.all().iter().map(|team| &team.scenario), "fly");
        let about = RecordingInfo { scenario, scenario_toml: &described.to_toml(), run: &run, is_fleet: true };
        let file =
            Recorder::begin(path, &about, None).map_err(|error| Error::Failed(format!("no recording: {error}")))?;
        let (origin, period) = (Origin::new(team.origin.geodetic()), Duration::from_secs_f64(1.0 / team.record_hz));
        Ok(Self { file, origin, period, window: None, samples: 0 })
    }

    /// Whether places are to be recorded now. Answers once for each sample. Nothing is recorded before the window, which begins as
    /// soon as all teams have begun theirs.
    pub fn is_due(&mut self, now: Instant, have_begun: impl FnOnce() -> bool) -> bool {
        if self.window.is_none() && have_begun() {
            self.window = Some((now, now));
            self.file.window_begins(now);
        }
        let Some((_, next)) = self.window.as_mut().filter(|(_, next)| now >= *next) else { return false };
        *next = (*next + self.period).max(now - self.period);
        self.samples += 1;
        true
    }

    /// Records where these vehicles of a team are, by their newest traces.
    pub fn places<'a>(&mut self, now: Instant, team: &Scenario, traces: impl Iterator<Item = &'a Trace>) {
        let (Some((zero, _)), Some(in_fleet)) = (self.window, team.team) else { return };
        let origin = Origin::new(team.origin.geodetic());
        let plausible = traces.filter(|trace| trace.is_plausible());
        let vehicles = plausible.map(|trace| {
            let place = self.origin.ned_from_geodetic(&origin.geodetic_from_ned(trace.position));
            VehiclePlace::new(
                trace.header.sender,
                trace.step,
                place,
                trace.position.altitude_m(),
                trace.in_place_s.is_some(),
            )
        });
        let vehicles = vehicles.collect();
        let t_s = now.saturating_duration_since(zero).as_secs_f64();
        self.file.places(now, TeamPlaces { team: in_fleet.id, t_s, vehicles });
    }

    /// Records an event that a vehicle reported.
    pub fn event(&mut self, at: Instant, team: TeamId, vehicle: VehicleId, what: EventKind) {
        if self.window.is_some() {
            self.file.event(at, VehicleName { team: Some(team), vehicle }, None, what);
        }
    }

    /// Records a fault that was injected into a team.
    pub fn fault(&mut self, at: Instant, team: TeamId, fault: &InjectedFault) {
        if self.window.is_some() {
            self.file.fault(at, Some(team), fault);
        }
    }
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::{Source, load_any};
    use skein_host::clock;
    use skein_lab::record::{FLEET_FILE, read_fleet};
    use skein_lab::scenario::ScenarioArgs;
    use skein_lab::world::World;

    use super::*;

    const FLEET: &str =
        "fleet = { teams = 2, pattern = \"line\", spacing_m = 300, record_hz = 2 }\nswarm.vehicles = 2\n";

    #[test]
    fn places_are_recorded_at_the_fleets_rate_in_the_fleets_frame_from_the_window_on() {
        let described = load_any(&Source { name: "fleet.toml", text: FLEET }, &[]).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FLEET_FILE);
        let mut recorder = FleetRecorder::begin(&path, &described).unwrap();
        let team = &described.all()[1].scenario;
        let ready = ScenarioArgs::default().ready(team).unwrap();
        let mut world = World::new(team, &ready.aircraft, &ready.rules).unwrap();
        world.tick();
        let traces: Vec<Trace> = world.traces().collect();
        let begin = clock::now();
        let id = TeamId::new(2).unwrap();
        recorder.event(begin, id, VehicleId::new(1).unwrap(), EventKind::Landed);
        assert!(!recorder.is_due(begin, || false));
        for nth in 0..100 {
            let now = begin + Duration::from_millis(20) * nth;
            if recorder.is_due(now, || true) {
                recorder.places(now, team, traces.iter());
            }
        }
        recorder.event(begin + Duration::from_secs(1), id, VehicleId::new(1).unwrap(), EventKind::Landed);
        assert_eq!((recorder.samples, recorder.file.finish().unwrap()), (4, 0));
        let places = read_fleet(&path).unwrap().places;
        assert_eq!(places.iter().map(|places| places.t_s).collect::<Vec<_>>(), [0.0, 0.5, 1.0, 1.5]);
        let east_m = traces[0].position.east_m() + team.team.unwrap().place_ne_m[1];
        assert_eq!((places[0].team, places[0].vehicles.len()), (id, 2));
        assert!((places[0].vehicles[0].east_m - east_m).abs() < 0.2, "{places:?}, not {east_m}");
        assert!(FleetRecorder::begin(&path, &described).is_err(), "a recording is never written over");
    }
}
