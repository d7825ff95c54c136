//! One flight of a fleet: its teams fly round by round, each in a world of its own, and share the air.
//!
//! A round is [`ROUND_TICKS`] frames. Within a round no team needs another, so a team flies its whole round while its
//! memory is in the processor's cache, and the threads share the teams. What comes out does not depend on their number.

mod sky;
mod team;

use std::num::NonZeroUsize;
use std::path::Path;

use skein_common::frame::Origin;
use skein_core::helicopter::TICK_S;
use skein_host::clock::now;
use skein_host::parallel::at_once;

use super::recorded::RunRecorder;
use super::{JOIN_LIMIT_S, Study, StudyError, longest_s};
use crate::metrics::across::Across;
use crate::metrics::{FleetReport, FleetTraffic, Run, Wall};
use crate::record::{self, RecordError, RecordingInfo};
use sky::Sky;
use team::Team;

/// Number of frames of a round: 0.2 s, the longest period of a state. With half of it, ten thousand vehicles cost a quarter
/// more, because each round brings a team's memory into the cache once.
const ROUND_TICKS: u64 = 10;

/// The folder for the recording of a fleet's flight, and the scenario files that go into it.
#[derive(Clone, Copy, Debug)]
pub struct FleetRecording<'a> {
    /// The folder of the run.
    pub folder: &'a Path,
    /// The complete file of the fleet.
    pub scenario_toml: &'a str,
    /// The complete scenario file of each team, in order.
    pub teams_toml: &'a [String],
}

/// Flies a fleet from the ground to the end of the longest team's window, or until all missions have ended, in this many
/// threads.
///
/// `teams` has the study of each team, in order. Their scenarios have
/// [`Scenario::team`](skein_common::scenario::Scenario::team), with the fleet's seed and origin, and seeds that follow from it.
///
/// # Errors
/// If a scenario cannot be flown, a vehicle does not join, or the recording cannot begin.
pub fn fly_fleet(
    teams: &[Study],
    threads: NonZeroUsize,
    recording: Option<&FleetRecording<'_>>,
) -> Result<(FleetReport, Result<(), RecordError>), StudyError> {
    let mut flight = FleetFlight::new(teams, recording)?;
    let started = now();
    while !flight.is_over()? {
        flight.round(threads);
    }
    let wall_s = now().duration_since(started).as_secs_f64();
    let FleetFlight { run, mut teams, across, recorder, recorded, ticks, .. } = flight;
    let flown_s = teams.first().map_or(0.0, |team| team.flight.world.t_s());
    let wall = Wall { wall_s, real_time_factor: flown_s / wall_s.max(1e-9) };
    let window_s = ticks as f64 * TICK_S;
    let recorded = recorded.and_then(|()| recorder.map_or(Ok(()), |recorder| recorder.finish(window_s)));
    let (reports, each): (Vec<_>, Vec<_>) = teams.iter_mut().map(|team| team.report(wall)).unzip();
    let recorded = [recorded].into_iter().chain(each).collect();
    let reports: Vec<_> = teams.iter().map(|team| team.id).zip(&reports).collect();
    let mut report = FleetReport::new(run, &reports, &across, Some(traffic(&teams)), wall);
    report.traffic = teams.iter().flat_map(Team::traffic).collect();
    Ok((report, recorded))
}

/// One flight of a fleet, from the ground to the end.
struct FleetFlight {
    run: Run,
    /// Origin of the fleet's frame.
    origin: Origin,
    teams: Vec<Team>,
    sky: Sky,
    across: Across,
    recorder: Option<RunRecorder>,
    /// The result of the recording so far: an error once the recording has failed.
    recorded: Result<(), RecordError>,
    /// Number of rounds between two recorded places.
    record_rounds: u64,
    /// Beginning of the figures' window; `None` while vehicles still join, s.
    zero_s: Option<f64>,
    ticks: u64,
    most_ticks: u64,
}

impl FleetFlight {
    fn new(studies: &[Study], recording: Option<&FleetRecording<'_>>) -> Result<Self, StudyError> {
        let mut teams = Vec::with_capacity(studies.len());
        for (nth, team) in studies.iter().enumerate() {
            let toml = recording.and_then(|recording| Some((recording.folder, recording.teams_toml.get(nth)?)));
            teams.push(Team::new(team, toml)?);
        }
        let first = &studies.first().ok_or(StudyError::NeverActive)?.scenario;
        let origin = Origin::new(first.team.map_or(first.origin, |fleet| fleet.origin).geodetic());
        let longest_s = studies.iter().map(|team| longest_s(&team.scenario)).fold(0.0, f64::max);
        let run = Run::of_all(studies.iter().map(|team| &team.scenario), "study");
        let recorder = recording.map(|recording| {
            let (scenario, scenario_toml) = (first, recording.scenario_toml);
            let about = RecordingInfo { scenario, scenario_toml, run: &run, is_fleet: true };
            RunRecorder::begin(&recording.folder.join(record::FLEET_FILE), &about)
        });
        let recorder = recorder.transpose()?;
        let record_hz = first.team.map_or(1.0, |fleet| fleet.record_hz);
        Ok(Self {
            run,
            origin,
            teams,
            sky: Sky::default(),
            across: Across::new(origin),
            recorder,
            recorded: Ok(()),
            record_rounds: (1.0 / (record_hz * ROUND_TICKS as f64 * TICK_S)).round().max(1.0) as u64,
            zero_s: None,
            ticks: 0,
            most_ticks: ((longest_s / TICK_S).round() as u64).next_multiple_of(ROUND_TICKS),
        })
    }

    /// Whether no round follows.
    fn is_over(&mut self) -> Result<bool, StudyError> {
        if self.zero_s.is_none() {
            let t_s = self.teams.first().map_or(0.0, |team| team.flight.world.t_s());
            if self.teams.iter().all(|team| team.flight.world.all_active()) {
                self.zero_s = Some(t_s);
            } else if t_s > JOIN_LIMIT_S {
                return Err(StudyError::NeverActive);
            }
        }
        let all_finished = || self.ticks > 0 && self.teams.iter().all(Team::has_finished);
        Ok(self.zero_s.is_some() && (self.ticks >= self.most_ticks || all_finished()))
    }

    /// Flies one round of every team, and exchanges the states between them.
    fn round(&mut self, threads: NonZeroUsize) {
        let Self { origin, teams, sky, zero_s, .. } = self;
        let (origin, zero_s) = (&*origin, *zero_s);
        let share = teams.len().div_ceil(threads.get()).max(1);
        {
            let sky = &*sky;
            at_once(teams.chunks_mut(share).map(|teams| {
                move || {
                    for team in teams {
                        team.receive(sky);
                        (0..ROUND_TICKS).for_each(|_| team.tick(origin, zero_s));
                        team.end_round(origin);
                    }
                }
            }));
        }
        let places: Vec<_> = teams.iter().flat_map(Team::cells).collect();
        sky.exchange(teams.iter_mut().map(|team| &mut team.sent), places.into_iter());
        if let Some(recorder) = &mut self.recorder {
            let with_places = (self.ticks / ROUND_TICKS).is_multiple_of(self.record_rounds);
            teams.iter_mut().for_each(|team| team.record(&mut recorder.writer, origin, with_places));
            if recorder.writer.failed().is_some() {
                // The figures need the room that its file takes.
                self.recorded = self.recorder.take().map_or(Ok(()), |recorder| recorder.finish(0.0));
            }
        }
        if zero_s.is_some() {
            self.across.observe(&teams.iter().map(|team| &team.airborne).collect::<Vec<_>>());
            self.ticks += ROUND_TICKS;
        }
    }
}

/// Counts the messages that the vehicles of these teams have received.
fn traffic(teams: &[Team]) -> FleetTraffic {
    let own = teams.iter().map(|team| (team.own_per_s(), team.flight.world.vehicle_count() as f64));
    let (messages, bytes, vehicles) = own.fold((0.0, 0.0, 0.0), |sum, (per_s, vehicles)| {
        (sum.0 + per_s.0 * vehicles, sum.1 + per_s.1 * vehicles, sum.2 + vehicles)
    });
    let surrounded = teams.iter().map(|team| team.received.surrounded);
    let (rounds, states, state_bytes) =
        surrounded.fold((0, 0, 0), |sum, team| (sum.0 + team.0, sum.1 + team.1, sum.2 + team.2));
    let over_s = rounds as f64 * ROUND_TICKS as f64 * TICK_S;
    let per_s = || (states as f64 / over_s + messages / vehicles, state_bytes as f64 / over_s + bytes / vehicles);
    FleetTraffic {
        stranger_states: teams.iter().map(|team| team.received.states).sum(),
        surrounded_per_s: (rounds > 0).then(per_s),
    }
}
