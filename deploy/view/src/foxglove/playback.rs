//! Plays a recording to Foxglove. All clients share one playback, which begins when the first of them reads a channel.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use foxglove::websocket::{PlaybackCommand, PlaybackControlRequest, PlaybackState, PlaybackStatus, Status};
use skein_host::clock;
use skein_lab::error::Error;
use skein_lab::record::{Player, RecordError, Replay};

use super::{Server, ServerSink, lock};

/// Time between two looks at what is to be sent.
const TICK: Duration = Duration::from_millis(25);
/// Slowest and fastest play, seconds of the recording in a second.
const SPEEDS: (f32, f32) = (0.01, 64.0);

/// The playback of a recording: its place, its speed and its status.
#[derive(Debug)]
pub(super) struct Playback {
    /// Log times of the first and the last message, ns.
    pub(super) span_ns: (u64, u64),
    /// Log time up to which the messages were sent, ns.
    at_ns: u64,
    speed: f32,
    status: PlaybackStatus,
    /// Whether `at_ns` is not the time up to which the messages were sent, but a new place.
    has_jumped: bool,
}

/// The messages to be sent now: those after one log time up to another, ns.
#[derive(Debug, PartialEq, Eq)]
struct Due {
    after_ns: u64,
    to_ns: u64,
    /// Whether the playback begins at a new place.
    has_jumped: bool,
    /// Whether the recording ends here.
    has_ended: bool,
}

impl Playback {
    fn new(span_ns: (u64, u64)) -> Self {
        Self { span_ns, at_ns: span_ns.0, speed: 1.0, status: PlaybackStatus::Playing, has_jumped: true }
    }

    /// Does what a client asks for, and answers it.
    pub(super) fn control(&mut self, request: &PlaybackControlRequest) -> PlaybackState {
        if request.playback_speed.is_finite() {
            self.speed = request.playback_speed.clamp(SPEEDS.0, SPEEDS.1);
        }
        let plays = request.playback_command == PlaybackCommand::Play;
        // Play at the end begins again.
        let again = (plays && self.status == PlaybackStatus::Ended).then_some(self.span_ns.0);
        let place_ns = request.seek_time.or(again);
        if let Some(place_ns) = place_ns {
            (self.at_ns, self.has_jumped) = (place_ns.clamp(self.span_ns.0, self.span_ns.1), true);
        }
        self.status = if plays { PlaybackStatus::Playing } else { PlaybackStatus::Paused };
        PlaybackState { request_id: Some(request.request_id.clone()), did_seek: place_ns.is_some(), ..self.state() }
    }

    fn state(&self) -> PlaybackState {
        PlaybackState {
            status: self.status,
            current_time: self.at_ns,
            playback_speed: self.speed,
            did_seek: false,
            request_id: None,
        }
    }

    /// Advances by this much of our time.
    fn advance(&mut self, passed: Duration) -> Due {
        let after_ns = self.at_ns;
        if self.status == PlaybackStatus::Playing {
            let played = passed.mul_f32(self.speed).as_nanos();
            self.at_ns = after_ns.saturating_add(u64::try_from(played).unwrap_or(u64::MAX)).min(self.span_ns.1);
        }
        let has_ended = self.status == PlaybackStatus::Playing && self.at_ns == self.span_ns.1;
        if has_ended {
            self.status = PlaybackStatus::Ended;
        }
        Due { after_ns, to_ns: self.at_ns, has_jumped: std::mem::take(&mut self.has_jumped), has_ended }
    }
}

/// Serves a recording until the process ends, and returns the address.
///
/// # Errors
/// If the recording cannot be read, or the address is not free.
pub(crate) fn play(path: &Path, address: SocketAddr) -> Result<SocketAddr, Error> {
    let unreadable = |error: RecordError| Error::Refused(error.to_string());
    let player = Player::open(path).map_err(unreadable)?;
    let playback = Arc::new(Mutex::new(Playback::new(player.span_ns())));
    let server = Server::start(address, path.display().to_string(), Some(Arc::clone(&playback)))?;
    server.parameters.show(player.described());
    let replay = Replay::new(player, server.sink()).map_err(unreadable)?;
    let listens = SocketAddr::new(address.ip(), server.handle.port());
    let failed = |error: std::io::Error| Error::Failed(format!("the recording cannot be played: {error}"));
    let thread = thread::Builder::new().name("play".to_owned());
    thread.spawn(move || serve(&server, replay, &playback)).map_err(failed)?;
    Ok(listens)
}

fn serve(server: &Server, mut replay: Replay<ServerSink>, playback: &Mutex<Playback>) {
    let mut last = clock::now();
    loop {
        clock::sleep(TICK);
        let now = clock::now();
        let passed = now.saturating_duration_since(std::mem::replace(&mut last, now));
        if !server.readers.are_any() {
            // The next reader sees it from the beginning, unless it waits at a place.
            let mut playback = lock(playback);
            if playback.status != PlaybackStatus::Paused {
                *playback = Playback::new(playback.span_ns);
            }
            continue;
        }
        let due = lock(playback).advance(passed);
        let has_new_reader = server.readers.take_new();
        let mut sent = Ok(());
        if due.has_jumped || has_new_reader {
            sent = replay.show(due.after_ns);
        }
        if due.to_ns > due.after_ns {
            sent = sent.and_then(|()| replay.play(due.after_ns, due.to_ns));
        }
        if let Err(error) = sent {
            server.handle.publish_status(Status::error(format!("{error}; `skein record --repair` may help")));
            lock(playback).status = PlaybackStatus::Paused;
        }
        server.handle.broadcast_time(due.to_ns);
        if due.has_ended {
            server.handle.broadcast_playback_state(lock(playback).state());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(command: PlaybackCommand, seek_time: Option<u64>) -> PlaybackControlRequest {
        let request_id = "7".to_owned();
        PlaybackControlRequest { playback_command: command, playback_speed: 2.0, seek_time, request_id }
    }

    #[test]
    fn a_recording_plays_from_its_beginning_to_its_end_and_again() {
        let mut playback = Playback::new((1_000, 9_000));
        let due = |playback: &mut Playback, passed_ns| playback.advance(Duration::from_nanos(passed_ns));
        let first = due(&mut playback, 500);
        assert_eq!(first, Due { after_ns: 1_000, to_ns: 1_500, has_jumped: true, has_ended: false });
        assert_eq!(due(&mut playback, 500), Due { after_ns: 1_500, to_ns: 2_000, has_jumped: false, has_ended: false });
        let last = due(&mut playback, u64::MAX);
        assert_eq!(last, Due { after_ns: 2_000, to_ns: 9_000, has_jumped: false, has_ended: true });
        assert_eq!(due(&mut playback, 500), Due { after_ns: 9_000, to_ns: 9_000, has_jumped: false, has_ended: false });
        assert_eq!(playback.state().status, PlaybackStatus::Ended);
        let again = playback.control(&request(PlaybackCommand::Play, None));
        assert_eq!((again.status, again.current_time, again.did_seek), (PlaybackStatus::Playing, 1_000, true));
        assert_eq!(due(&mut playback, 500), Due { after_ns: 1_000, to_ns: 2_000, has_jumped: true, has_ended: false });
    }

    #[test]
    fn a_client_pauses_seeks_and_sets_the_speed_within_bounds() {
        let mut playback = Playback::new((1_000, 9_000));
        let paused = playback.control(&request(PlaybackCommand::Pause, Some(4_000)));
        assert_eq!((paused.status, paused.current_time), (PlaybackStatus::Paused, 4_000));
        assert_eq!((paused.request_id.as_deref(), paused.playback_speed), (Some("7"), 2.0));
        let still = playback.advance(Duration::from_secs(60));
        assert_eq!(still, Due { after_ns: 4_000, to_ns: 4_000, has_jumped: true, has_ended: false });
        for (wanted, speed) in [(f32::NAN, 2.0), (f32::INFINITY, 2.0), (-3.0, 0.01), (1e9, 64.0)] {
            let request = PlaybackControlRequest { playback_speed: wanted, ..request(PlaybackCommand::Pause, None) };
            assert_eq!(playback.control(&request).playback_speed, speed, "{wanted}");
        }
        assert_eq!(playback.control(&request(PlaybackCommand::Play, Some(u64::MAX))).current_time, 9_000);
        assert_eq!(playback.control(&request(PlaybackCommand::Play, Some(0))).current_time, 1_000);
    }
}
