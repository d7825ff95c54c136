//! Asks the simulator once, after its first position, which of the profile's datarefs it has, whether its random failures
//! are on, and which aircraft it has loaded, and compares the ground with the scenario's origin. It asks again after everything that can change the answers: a restart of the
//! simulator, a placement, a second without positions, in which an aircraft may have been loaded, and a change of the path or
//! of the random failures, which stay subscribed.
//!
//! X-Plane does not answer a request for a dataref that it does not have. One that has not answered several requests is
//! reported by name. The path of the aircraft's file comes byte by byte; it is asked for only if the profile expects one. Any
//! other path differs in one of the bytes that stay subscribed, which are those up to the zero at its end.

use std::collections::VecDeque;
use std::ops::Range;
use std::time::{Duration, Instant};

use super::session::MAX_QUESTIONS;
use crate::plant::xplane::placing::LEVEL_WITHIN_M;
use crate::plant::xplane::wire::rref::DatarefRequest;
use skein_common::message::{ShortText, SimulatorFault};
use skein_core::aircraft::Profile;

/// Datarefs of which one is not zero while random failures are on: the name since X-Plane 12, and the misspelt one before.
pub const RANDOM_FAILURES: [&str; 2] =
    ["sim/operation/failures/enable_random_failures", "sim/operation/failures/enable_random_falures"];
/// The path of the aircraft's file, below X-Plane's folder.
const PATH: &str = "sim/aircraft/view/acf_relative_path";
/// Most bytes of it that are asked for.
const PATH_BYTES: usize = 160;
/// Most datarefs of a profile that are asked for.
const MOST_DATAREFS: usize = MAX_QUESTIONS - PATH_BYTES - RANDOM_FAILURES.len();
/// Answers a second that are asked for, and the time between two requests for one dataref.
const ANSWERS_HZ: u32 = 2;
const ROUND: Duration = Duration::from_secs(1);
/// Time after which a dataref that has not answered does not exist.
const GIVEN_UP: Duration = Duration::from_secs(5);
/// Number of requests that are sent at once, and the time between two batches: X-Plane takes about 148 in a frame.
const BATCH: usize = 50;
const BATCH_PERIOD: Duration = Duration::from_millis(100);

/// A dataref, and its value once it has answered.
#[derive(Debug)]
struct Question {
    path: String,
    answer: Option<f32>,
}

/// The progress of the inquiry.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum InquiryState {
    /// The simulator has not sent a position yet.
    #[default]
    Waiting,
    /// Asked from the first time on, and in this round from the second.
    Asking(Instant, Instant),
    /// Everything was asked; random failures and the path stay subscribed.
    Ended,
}

/// The questions to the simulator, and its answers.
#[derive(Debug, Default)]
pub(super) struct Inquiry {
    /// The profile's datarefs, then those of random failures, then the bytes of the path if one is expected.
    questions: Vec<Question>,
    /// Number of the profile's datarefs.
    datarefs: usize,
    /// Part of the path that is expected.
    acf: Option<String>,
    /// Whether random failures are reported as wanted.
    pub(super) wants_failures: bool,
    state: InquiryState,
    /// Requests that wait: the question, answers a second.
    waiting: VecDeque<(usize, u32)>,
    last_batch: Option<Instant>,
    /// Path of another aircraft than the expected one.
    other: Option<String>,
    /// Whether the loaded aircraft has been compared since the last start of the inquiry.
    is_compared: bool,
    /// Height of the ground below the aircraft above the scenario's origin, m; `None` if the aircraft is too far from there. The
    /// next inquiry reports it.
    pub(super) ground_m: Option<f64>,
    /// Faults that the last complete inquiry has found.
    pub(super) faults: Vec<SimulatorFault>,
}

impl Inquiry {
    /// An inquiry for this profile.
    pub(super) fn new(profile: &Profile) -> Self {
        let datarefs = profile.datarefs();
        let own = datarefs.iter().map(|dataref| dataref.as_str().to_owned()).take(MOST_DATAREFS);
        let failures = RANDOM_FAILURES.into_iter().map(str::to_owned);
        let bytes = if profile.acf.is_some() { PATH_BYTES } else { 0 };
        let path = (0..bytes).map(|nth| format!("{PATH}[{nth}]"));
        Self {
            datarefs: datarefs.len().min(MOST_DATAREFS),
            questions: own.chain(failures).chain(path).map(|path| Question { path, answer: None }).collect(),
            acf: profile.acf.clone(),
            ..Self::default()
        }
    }

    /// Path of the loaded aircraft, if it is known to be another one than the profile is for.
    pub(super) fn other_aircraft(&self) -> Option<ShortText> {
        self.other.as_deref().map(ShortText::of)
    }

    /// Asks anew: the simulator was restarted, or may have loaded another aircraft.
    pub(super) fn restart(&mut self) {
        self.state = InquiryState::Waiting;
    }

    /// Takes an answer. The inquiry begins anew if random failures were turned on or off, or if a byte of the path has
    /// changed, because another aircraft is loaded.
    pub(super) fn answer(&mut self, nth: usize, value: f32) {
        let Some(question) = self.questions.get_mut(nth) else { return };
        let before = question.answer.replace(value);
        if nth >= self.datarefs && before.is_some_and(|before| before != value) {
            self.restart();
        }
    }

    /// Continues the inquiry: `ask` gets the number, the path and the rate of each request that is due. Call it often.
    pub(super) fn proceed(&mut self, now: Instant, is_answering: bool, mut ask: impl FnMut(usize, DatarefRequest<'_>)) {
        match self.state {
            InquiryState::Waiting if is_answering => {
                self.questions.iter_mut().for_each(|question| question.answer = None);
                self.is_compared = false;
                self.state = InquiryState::Asking(now, now);
                self.begin_round();
            }
            InquiryState::Asking(since, _) if self.is_complete() || now >= since + GIVEN_UP => {
                self.end();
            }
            InquiryState::Asking(since, round) if now >= round + ROUND && self.waiting.is_empty() => {
                self.state = InquiryState::Asking(since, now);
                self.begin_round();
            }
            // The vehicle must not take off before the wrong aircraft is noticed.
            InquiryState::Asking(..) if !self.is_compared && self.path().is_some_and(|(_, is_whole)| is_whole) => {
                self.compare_aircraft();
            }
            _ => {}
        }
        if !self.waiting.is_empty() && self.last_batch.is_none_or(|last| now >= last + BATCH_PERIOD) {
            self.last_batch = Some(now);
            for (nth, frequency_hz) in self.waiting.drain(..self.waiting.len().min(BATCH)) {
                ask(nth, DatarefRequest { frequency_hz, index: 0, path: &self.questions[nth].path });
            }
        }
    }

    /// Ends all subscriptions.
    pub(super) fn release(&self, mut ask: impl FnMut(usize, DatarefRequest<'_>)) {
        let subscribed = match self.state {
            _ if self.last_batch.is_none() => 0..0,
            InquiryState::Ended if self.waiting.is_empty() => self.watched(),
            _ => 0..self.questions.len(),
        };
        for nth in subscribed {
            ask(nth, DatarefRequest { frequency_hz: 0, index: 0, path: &self.questions[nth].path });
        }
    }

    /// Asks for everything that has not answered.
    fn begin_round(&mut self) {
        let open = self.questions.iter().enumerate().filter(|(_, question)| question.answer.is_none());
        self.waiting.extend(open.map(|(nth, _)| (nth, ANSWERS_HZ)));
    }

    /// Questions that stay subscribed: about random failures, and about the bytes of the path up to the zero at its end.
    fn watched(&self) -> Range<usize> {
        let (datarefs, failures, bytes) = self.parts();
        let length = bytes.iter().take_while(|byte| byte.answer.is_some_and(|value| value != 0.0)).count();
        datarefs.len()..self.questions.len().min(datarefs.len() + failures.len() + length + 1)
    }

    /// The profile's datarefs, those of random failures, and the bytes of the path.
    fn parts(&self) -> (&[Question], &[Question], &[Question]) {
        let (datarefs, others) = self.questions.split_at(self.datarefs);
        let (failures, bytes) = others.split_at(RANDOM_FAILURES.len());
        (datarefs, failures, bytes)
    }

    /// Whether every dataref has answered, one of random failures, and the path up to its end.
    fn is_complete(&self) -> bool {
        let (datarefs, failures, _) = self.parts();
        let has_path = self.acf.is_none() || self.path().is_some_and(|(_, is_whole)| is_whole);
        let has_answered = |question: &Question| question.answer.is_some();
        datarefs.iter().all(has_answered) && failures.iter().any(has_answered) && has_path
    }

    /// The path as far as it has answered without a gap, and whether that is all of it; `None` if nothing has answered.
    fn path(&self) -> Option<(String, bool)> {
        let (_, _, bytes) = self.parts();
        let mut path = Vec::new();
        for byte in bytes {
            match byte.answer {
                Some(0.0) => return Some((String::from_utf8_lossy(&path).into_owned(), true)),
                Some(value) => path.push(value as u8),
                None => break,
            }
        }
        (!path.is_empty()).then(|| (String::from_utf8_lossy(&path).into_owned(), false))
    }

    /// Ends the inquiry and its subscriptions, except those that stay, and reports what it has found.
    fn end(&mut self) {
        self.state = InquiryState::Ended;
        let watched = self.watched();
        self.waiting.clear();
        self.waiting.extend((0..self.questions.len()).filter(|nth| !watched.contains(nth)).map(|nth| (nth, 0)));
        self.faults = self.found();
        if !self.is_compared {
            self.compare_aircraft();
        }
    }

    /// The faults that the answers show: datarefs of the profile that have not answered, random failures, and ground that is not at the
    /// height of the origin.
    fn found(&self) -> Vec<SimulatorFault> {
        let (datarefs, failures, _) = self.parts();
        let is_on = failures.iter().any(|question| question.answer.is_some_and(|value| value != 0.0));
        let missing = datarefs.iter().filter(|question| question.answer.is_none());
        let missing = missing.map(|question| SimulatorFault::NoDataref(ShortText::of(&question.path)));
        let random =
            if self.wants_failures { SimulatorFault::WantedRandomFailures } else { SimulatorFault::RandomFailures };
        let largest_m = f64::from(SimulatorFault::MAX_GROUND_OFF_M);
        let ground = self.ground_m.filter(|ground_m| ground_m.abs() > LEVEL_WITHIN_M);
        let ground = ground.map(|ground_m| ground_m.round().clamp(-largest_m, largest_m) as i32);
        let ground = ground.map(SimulatorFault::GroundOffOrigin);
        let first = is_on.then_some(random).into_iter().chain(ground);
        first.chain(missing).take(SimulatorFault::MAX_COUNT).collect()
    }

    fn compare_aircraft(&mut self) {
        self.is_compared = true;
        let Some(acf) = &self.acf else { return };
        let other = match self.path() {
            Some((path, _)) if path.contains(acf.as_str()) => None,
            Some((path, true)) => Some(path),
            _ => {
                tracing::warn!("X-Plane did not report which aircraft it has loaded: see that it is the one for {acf}");
                None
            }
        };
        if let Some(path) = other.as_ref().filter(|_| other != self.other) {
            tracing::warn!(
                "X-Plane has loaded {}, but the aircraft's file is for {acf}: load that aircraft, or fly with the file of \
                 this one",
                skein_common::printable::printable(path, PATH_BYTES)
            );
        }
        self.other = other;
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use skein_host::clock::now;

    /// A simulator with some datarefs and this aircraft, which answers at once and then twice a second.
    struct Bench {
        inquiry: Inquiry,
        now: Instant,
        acf: &'static str,
        /// The datarefs that it does not have.
        missing: &'static str,
        /// Whether its random failures are on.
        is_failing: bool,
        /// Share of requests that it takes, as one in so many.
        one_in: usize,
        asked: usize,
        frames: u32,
        /// Subscriptions that have not been ended.
        open: BTreeSet<usize>,
    }

    impl Bench {
        fn new(acf: Option<&str>) -> Self {
            let profile = Profile { acf: acf.map(str::to_owned), ..Profile::default() };
            Self {
                inquiry: Inquiry::new(&profile),
                now: now(),
                acf: "Aircraft/Laminar/R22.acf",
                missing: "-",
                is_failing: false,
                one_in: 1,
                asked: 0,
                frames: 0,
                open: BTreeSet::new(),
            }
        }

        fn run(&mut self, for_s: f64) {
            for _ in 0..(for_s * 50.0) as u32 {
                self.now += Duration::from_millis(20);
                self.frames += 1;
                let mut due: Vec<usize> =
                    if self.frames.is_multiple_of(25) { self.open.iter().copied().collect() } else { Vec::new() };
                let mut batch = 0;
                self.inquiry.proceed(self.now, true, |nth, request| {
                    batch += 1;
                    self.asked += 1;
                    if request.frequency_hz == 0 {
                        self.open.remove(&nth);
                    } else if !request.path.contains(self.missing) && self.asked.is_multiple_of(self.one_in) {
                        self.open.insert(nth);
                        due.push(nth);
                    }
                });
                assert!(batch <= BATCH, "{batch} requests in a frame");
                for nth in due {
                    let path = self.inquiry.questions[nth].path.as_str();
                    let byte = path.strip_prefix(PATH).map(|rest| rest.trim_matches(['[', ']']).parse::<usize>());
                    let value = match byte {
                        Some(nth) => self.acf.as_bytes().get(nth.unwrap()).copied().unwrap_or(0).into(),
                        None if RANDOM_FAILURES.contains(&path) => f32::from(self.is_failing),
                        None => 1.0,
                    };
                    self.inquiry.answer(nth, value);
                }
            }
        }

        fn faults(&self) -> Vec<String> {
            self.inquiry.faults.iter().map(ToString::to_string).collect()
        }
    }

    #[test]
    fn nothing_is_asked_before_the_simulator_answers_and_only_what_can_change_stays_subscribed() {
        for (acf, length) in [(None, 0), (Some("R22"), "Aircraft/Laminar/R22.acf".len() + 1)] {
            let mut bench = Bench::new(acf);
            bench.inquiry.proceed(bench.now, false, |_, _| panic!("asked a silent simulator"));
            bench.inquiry.release(|_, _| panic!("there is nothing to end"));
            bench.run(1.0);
            assert!(bench.faults().is_empty() && bench.inquiry.other_aircraft().is_none());
            if acf.is_some() {
                assert_eq!(bench.inquiry.path(), Some(("Aircraft/Laminar/R22.acf".to_owned(), true)));
            }
            let asked = bench.asked;
            bench.run(10.0);
            let (first, end) = (bench.inquiry.datarefs, bench.inquiry.datarefs + RANDOM_FAILURES.len() + length);
            assert!(bench.open.iter().copied().eq(first..end), "{:?}", bench.open);
            assert!(bench.asked <= asked + PATH_BYTES + 20, "each once");
            bench.inquiry.release(|nth, _| assert!(bench.open.remove(&nth), "{nth} was not subscribed"));
            assert!(bench.open.is_empty());
        }
    }

    #[test]
    fn a_dataref_that_never_answers_is_named_after_five_seconds() {
        let mut bench = Bench::new(None);
        bench.missing = "governor_on";
        bench.run(4.0);
        assert!(bench.faults().is_empty(), "requests may have been lost");
        bench.run(2.0);
        let dataref = "sim/cockpit2/engine/actuators/governor_on[0]";
        let remedy = "correct the table [xplane] of the aircraft file";
        assert_eq!(bench.faults(), [format!("simulator does not answer {dataref}, {remedy}")]);
    }

    #[test]
    fn random_failures_are_found_under_either_name_and_no_longer_once_they_are_off() {
        for other in RANDOM_FAILURES {
            let mut bench = Bench::new(None);
            bench.missing = other;
            bench.run(2.0);
            for (is_failing, faults) in [(true, &[SimulatorFault::RandomFailures][..]), (false, &[]), (true, &[])] {
                bench.is_failing = is_failing;
                bench.inquiry.wants_failures = is_failing && faults.is_empty();
                bench.run(2.0);
                let wanted = [SimulatorFault::WantedRandomFailures];
                let expected = if bench.inquiry.wants_failures { &wanted } else { faults };
                assert_eq!(bench.inquiry.faults, expected, "without {other}");
            }
        }
    }

    #[test]
    fn ground_that_is_not_at_the_height_of_the_origin_is_reported_until_it_is() {
        let mut bench = Bench::new(None);
        for (ground_m, expected) in [
            (Some(14.9), None),
            (Some(42.4), Some("ground is 42 m above the scenario's origin")),
            (Some(-15.6), Some("ground is 16 m below the scenario's origin")),
            (None, None),
            (Some(f64::NAN), None),
            (Some(f64::INFINITY), Some("ground is 20000 m above the scenario's origin")),
        ] {
            bench.inquiry.restart();
            bench.inquiry.ground_m = ground_m;
            bench.run(6.0);
            let remedy = ", set origin.elevation_m to that of the ground";
            let expected: Vec<_> = expected.into_iter().map(|expected| format!("{expected}{remedy}")).collect();
            assert_eq!(bench.faults(), expected, "{ground_m:?}");
        }
    }

    #[test]
    fn lost_requests_are_repeated() {
        let mut bench = Bench::new(Some("R22"));
        bench.one_in = 2;
        bench.run(6.0);
        assert!(bench.faults().is_empty(), "{:?}", bench.faults());
        assert!(bench.inquiry.other_aircraft().is_none());
    }

    #[test]
    fn another_aircraft_is_noticed_until_the_right_one_is_loaded() {
        let mut bench = Bench::new(Some("S-76"));
        bench.missing = "governor_on";
        bench.run(1.0);
        assert_eq!(bench.inquiry.other.as_deref(), Some("Aircraft/Laminar/R22.acf"));
        // The next one is compared as soon as a byte of its path differs; the first differs in its zero alone.
        for (acf, is_other) in [
            ("Aircraft/Laminar/R22.acf2", true),
            ("Aircraft/Laminar/S-76C.acf", false),
            ("Aircraft/Laminar/S-76D.acf", false),
            ("Aircraft/Laminar/R22.acf", true),
        ] {
            bench.acf = acf;
            bench.run(1.6);
            assert_eq!(bench.inquiry.path(), Some((acf.to_owned(), true)));
            assert_eq!(bench.inquiry.other_aircraft(), is_other.then(|| ShortText::of(acf)));
        }
    }
}
