//! Asks one X-Plane for many values at once, and writes single ones: for the commands that check it and give its controls
//! back. An agent's own link is [`skein_agent::plant::xplane::XPlane`].

use std::collections::BTreeMap;
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use skein_agent::plant::xplane::wire::dref::Write;
use skein_agent::plant::xplane::wire::encode_rate;
use skein_agent::plant::xplane::wire::operation::Command;
use skein_agent::plant::xplane::wire::prel::Placement;
use skein_agent::plant::xplane::wire::rpos::{self, Position};
use skein_agent::plant::xplane::wire::rref::{self, DatarefRequest};
use skein_agent::plant::xplane::{listen_for, simulator};
use skein_host::clock;
use skein_lab::error::Error;

use crate::os;

/// Values a second that are asked for.
const VALUES_HZ: u32 = 10;
/// Number of requests that are sent at once, and the time between two such batches: X-Plane takes about 148 a frame.
const BATCH: usize = 100;
const BATCH_EVERY: Duration = Duration::from_millis(100);
/// Time after which a survey asks again for what has not come: datagrams are lost.
const ASK_AGAIN: Duration = Duration::from_millis(500);
/// A simulator that has sent nothing in this time is given up.
pub const SILENT: Duration = Duration::from_secs(2);
/// Size of the largest datagram that is received.
const LARGEST: usize = 2048;
/// Dataref of X-Plane's version number, as [`version_text`] reads it.
pub const VERSION: &str = "sim/version/xplane_internal_version";
/// Dataref of the path of the aircraft's file, a character each.
pub const ACF: &str = "sim/aircraft/view/acf_relative_path";
/// Time limit for X-Plane to show what was written.
const WRITTEN_WITHIN: Duration = Duration::from_secs(3);
/// Largest random first index: the indices above it are still positive.
const FIRST_INDEX_MASK: i32 = 0x3FFF_FFFF;

/// The answers of one X-Plane.
#[derive(Clone, Debug, Default)]
pub struct Survey {
    /// Newest value of each dataref that answered.
    pub values: BTreeMap<String, f32>,
    /// The times at which positions came, s after the survey began.
    pub positions_s: Vec<f64>,
    /// The newest position.
    pub position: Option<Position>,
    /// Datagrams of this simulator that follow no known layout.
    pub malformed: u64,
    /// All datagrams, each with the time when it came, s after the survey began; none unless they are kept.
    pub datagrams: Vec<(f64, Vec<u8>)>,
}

/// A socket to one X-Plane.
#[derive(Debug)]
pub struct Surveyor {
    socket: UdpSocket,
    /// Address of the simulator.
    pub simulator: SocketAddr,
}

impl Surveyor {
    /// Opens a socket for the X-Plane at `HOST[:PORT]`.
    ///
    /// # Errors
    /// If the address is unknown, or no socket can be opened.
    pub fn open(address: &str) -> Result<Self, Error> {
        let simulator = simulator(address).map_err(|error| Error::Refused(error.to_string()))?;
        let socket = UdpSocket::bind((listen_for(simulator.ip()), 0))
            .map_err(|error| Error::Failed(format!("cannot open a UDP socket: {error}")))?;
        Ok(Self { socket, simulator })
    }

    /// Asks for these datarefs and, at `positions_hz` (0: none), for positions, and again for what does not come. Receives
    /// for this time from the first answer on, or until all datarefs have answered if no positions are wanted, or until the simulator
    /// has been silent for [`SILENT`]; then ends the subscriptions.
    ///
    /// # Errors
    /// If the system provides no random numbers.
    pub fn survey(
        &self,
        datarefs: &[String],
        positions_hz: u32,
        time: Duration,
        keeps_datagrams: bool,
    ) -> Result<Survey, Error> {
        let random = os::random_bytes().map(i32::from_le_bytes);
        let random = random.ok_or_else(|| Error::Failed("this system provides no random numbers".to_owned()))?;
        let first = random & FIRST_INDEX_MASK;
        let begin = clock::now();
        let mut survey = Survey::default();
        let (mut until, mut ask_at) = (begin + SILENT, begin);
        let mut buffer = [0; LARGEST];
        while clock::now() < until && (positions_hz > 0 || survey.values.len() < datarefs.len()) {
            if clock::now() >= ask_at {
                let wants_positions = positions_hz > 0 && survey.position.is_none();
                let is_missing = |path: &str| survey.value(path).is_none();
                self.subscribe(datarefs, first, VALUES_HZ, wants_positions.then_some(positions_hz), is_missing);
                ask_at = clock::now() + ASK_AGAIN;
            }
            let Some(size) = self.receive(&mut buffer, until.min(ask_at)) else { continue };
            let (now, was_silent) = (clock::now(), !survey.has_answered());
            let after_s = now.saturating_duration_since(begin).as_secs_f64();
            survey.take(&buffer[..size], datarefs, first, after_s);
            if was_silent && survey.has_answered() {
                until = now + time;
            }
            if keeps_datagrams {
                survey.datagrams.push((after_s, buffer[..size].to_vec()));
            }
        }
        self.subscribe(datarefs, first, 0, Some(0), |_| true);
        Ok(survey)
    }

    /// Asks for these datarefs, `each` time so long, until they are as wanted or the time `within` is over. Returns the last survey,
    /// and whether it is as wanted.
    ///
    /// # Errors
    /// The errors of [`Self::survey`].
    pub(crate) fn survey_until(
        &self,
        datarefs: &[String],
        each: Duration,
        within: Duration,
        is_wanted: impl Fn(&Survey) -> bool,
    ) -> Result<(Survey, bool), Error> {
        let until = clock::now() + within;
        loop {
            let survey = self.survey(datarefs, 0, each, false)?;
            let is_as_wanted = is_wanted(&survey);
            if is_as_wanted || clock::now() >= until {
                return Ok((survey, is_as_wanted));
            }
        }
    }

    /// Whether all of these datarefs get this value soon.
    ///
    /// # Errors
    /// The errors of [`Self::survey`].
    pub fn reads(&self, paths: &[String], value: f32) -> Result<bool, Error> {
        let are_equal = |survey: &Survey| paths.iter().all(|path| survey.value(path) == Some(value));
        Ok(self.survey_until(paths, Duration::from_millis(500), WRITTEN_WITHIN, are_equal)?.1)
    }

    /// Writes a value, three times because X-Plane does not acknowledge it.
    pub fn write(&self, path: &str, value: f32) {
        let mut bytes = Vec::new();
        if (Write { value, path }).encode(&mut bytes).is_ok() {
            (0..3).for_each(|_| self.send(&bytes));
        }
    }

    /// Places an aircraft, three times because X-Plane does not acknowledge it.
    pub(crate) fn place(&self, placement: &Placement) {
        let mut bytes = Vec::new();
        placement.encode(&mut bytes);
        (0..3).for_each(|_| self.send(&bytes));
    }

    /// Runs a command of X-Plane, once.
    pub fn command(&self, path: &str) {
        let mut bytes = Vec::new();
        if (Command { path }).encode(&mut bytes).is_ok() {
            self.send(&bytes);
        }
    }

    /// Sends a datagram; a lost one shows as a simulator that does not answer.
    fn send(&self, bytes: &[u8]) {
        let _ = self.socket.send_to(bytes, self.simulator);
    }

    /// Requests positions at this rate, if any, and the datarefs that `is_wanted` names; rates of zero end the subscriptions.
    fn subscribe(
        &self,
        datarefs: &[String],
        first: i32,
        values_hz: u32,
        positions_hz: Option<u32>,
        is_wanted: impl Fn(&str) -> bool,
    ) {
        let mut bytes = Vec::new();
        if let Some(positions_hz) = positions_hz {
            encode_rate(&rpos::TAG, positions_hz, &mut bytes);
            self.send(&bytes);
        }
        let wanted = datarefs.iter().enumerate().filter(|(_, path)| is_wanted(path));
        for (sent, (nth, path)) in wanted.enumerate() {
            if sent > 0 && sent % BATCH == 0 {
                clock::sleep(BATCH_EVERY);
            }
            let request = DatarefRequest { frequency_hz: values_hz, index: first + nth as i32, path };
            if request.encode(&mut bytes).is_ok() {
                self.send(&bytes);
            }
        }
    }

    /// Size of the next datagram from the simulator's address; `None` if none comes in time.
    fn receive(&self, buffer: &mut [u8], deadline: Instant) -> Option<usize> {
        loop {
            let left = deadline.saturating_duration_since(clock::now()).max(Duration::from_millis(1));
            self.socket.set_read_timeout(Some(left)).ok()?;
            match self.socket.recv_from(buffer) {
                Ok((size, from)) if from.ip() == self.simulator.ip() => return Some(size),
                Ok(_) => {}
                // On some systems a refusing host makes the next receive fail; the wait continues.
                Err(error) if error.kind() == io::ErrorKind::ConnectionReset => clock::sleep(Duration::from_millis(10)),
                Err(_) => return None,
            }
            if clock::now() >= deadline {
                return None;
            }
        }
    }
}

impl Survey {
    /// The value of a dataref, if it answered.
    pub fn value(&self, path: &str) -> Option<f32> {
        self.values.get(path).copied()
    }

    /// Whether anything came.
    pub fn has_answered(&self) -> bool {
        !self.values.is_empty() || self.position.is_some()
    }

    fn take(&mut self, datagram: &[u8], datarefs: &[String], first: i32, after_s: f64) {
        if let (Some(&rpos::TAG), Ok(position)) = (datagram.first_chunk(), Position::decode(datagram)) {
            self.position = Some(position);
            self.positions_s.push(after_s);
        } else if let (Some(&rref::TAG), Ok(values)) = (datagram.first_chunk(), rref::decode_values(datagram)) {
            for (index, value) in values {
                // Indices of another program's subscription are not ours.
                let nth = index.checked_sub(first).and_then(|nth| usize::try_from(nth).ok());
                if let Some(path) = nth.and_then(|nth| datarefs.get(nth)) {
                    self.values.insert(path.clone(), value);
                }
            }
        } else {
            self.malformed += 1;
        }
    }
}

/// Formats X-Plane's version number: 121400 is 12.1.4.
pub fn version_text(version: impl Into<i64>) -> String {
    let version = version.into();
    format!("{}.{}.{}", version / 10_000, version / 1_000 % 10, version / 100 % 10)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::thread;

    use super::*;

    /// A simulator that loses the first request for each thing.
    #[test]
    fn what_a_simulator_does_not_send_is_asked_for_again() {
        let simulator = UdpSocket::bind("127.0.0.1:0").unwrap();
        simulator.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        let surveyor = Surveyor::open(&simulator.local_addr().unwrap().to_string()).unwrap();
        let lossy = thread::spawn(move || {
            let (mut buffer, mut lost) = ([0; LARGEST], BTreeSet::new());
            // The requests that end the subscriptions are for positions, or have a rate of zero.
            while let Ok((size, from)) = simulator.recv_from(&mut buffer)
                && let Ok(DatarefRequest { frequency_hz: 1.., index, .. }) = DatarefRequest::decode(&buffer[..size])
            {
                if !lost.insert(index) {
                    let value = [&rref::TAG[..], b",", &index.to_le_bytes(), &7.0_f32.to_le_bytes()].concat();
                    simulator.send_to(&value, from).unwrap();
                }
            }
        });
        let datarefs = ["sim/one", "sim/another"].map(str::to_owned);
        let survey = surveyor.survey(&datarefs, 0, Duration::from_secs(10), false).unwrap();
        assert!(datarefs.iter().all(|path| survey.value(path) == Some(7.0)), "{survey:?}");
        lossy.join().unwrap();
    }
}
