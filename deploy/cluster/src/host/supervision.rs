//! The decisions of a supervisor: when it starts the agent, kills it and starts it again. They use no process, file or
//! clock, so that a test can fly a swarm with its supervisors in virtual time.

use std::time::{Duration, Instant};

use super::watchdog::Watchdog;

/// Interval at which the agent is checked.
pub const POLL_PERIOD: Duration = Duration::from_millis(50);
/// The longest pause before an agent is restarted.
pub const LONGEST_PAUSE: Duration = Duration::from_secs(10);
/// The first pause before an agent is restarted; each further pause is twice as long.
const FIRST_PAUSE: Duration = Duration::from_millis(500);
/// An agent that has run for this long did not fail at its start: pauses begin with the shortest again.
const STABLE: Duration = Duration::from_secs(60);

/// The agent of a supervisor, and the requests to the supervisor itself.
pub trait Supervised {
    /// Gets ready to receive the reports of the next agent.
    ///
    /// # Errors
    /// Why no report can be received: an agent that hangs is then not noticed.
    fn listen(&mut self) -> Result<(), String>;

    /// Starts the agent.
    ///
    /// # Errors
    /// Why it cannot be started.
    fn start(&mut self) -> Result<(), String>;

    /// The end of the agent; `None` while it runs.
    fn ended(&mut self) -> Option<AgentEnd>;

    /// Whether the agent has reported since the last call that its control thread runs.
    fn has_reported(&mut self) -> bool;

    /// Kills the agent.
    fn kill(&mut self);

    /// Asks the agent to end.
    fn ask_to_end(&mut self);

    /// Number of requests to end that the supervisor has received.
    fn requests(&self) -> u32;

    /// Writes a line into the agent's log.
    fn note(&mut self, what: &str);
}

/// The end of an agent.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AgentEnd {
    /// Whether it ended successfully: it is not started again then.
    pub is_success: bool,
    /// Description of the end, which completes a sentence that begins with "the agent".
    pub how: String,
}

/// Supervises one agent until it has ended successfully, or the supervisor is asked to end: then the agent is asked to end. By default
/// the agent has to be started.
#[derive(Debug, Default)]
pub struct Supervision {
    state: SupervisedState,
    /// The last pause before a restart.
    pause: Duration,
    /// Number of requests to end that were passed on to the agent.
    passed_on: u32,
}

#[derive(Debug, Default)]
enum SupervisedState {
    #[default]
    Starts,
    Runs {
        since: Instant,
        /// `None` if a hang cannot be noticed, or the agent was killed already.
        dog: Option<Watchdog>,
    },
    Pauses {
        until: Instant,
    },
}

impl Supervision {
    /// Supervises an agent that runs already.
    pub fn taking_over(agent: &mut impl Supervised, now: Instant) -> Self {
        agent.note("takes over the running agent");
        let dog = listen(agent, now);
        Self { state: SupervisedState::Runs { since: now, dog }, ..Self::default() }
    }

    /// Acts on what has happened to the agent; call it every [`POLL_PERIOD`]. Returns whether the supervisor's work is over.
    pub fn poll(&mut self, agent: &mut impl Supervised, now: Instant) -> bool {
        let (begun, ended) = match &mut self.state {
            SupervisedState::Pauses { until } if agent.requests() == 0 && now < *until => return false,
            SupervisedState::Pauses { .. } if agent.requests() == 0 => {
                self.state = SupervisedState::Starts;
                return self.poll(agent, now);
            }
            SupervisedState::Pauses { .. } => {
                agent.note("ending");
                return true;
            }
            SupervisedState::Starts => {
                // Before the agent starts, because its reports need the socket.
                let dog = listen(agent, now);
                match agent.start() {
                    Ok(()) => {
                        self.state = SupervisedState::Runs { since: now, dog };
                        return false;
                    }
                    Err(error) => {
                        agent.note(&format!("the agent cannot be started: {error}"));
                        (now, None)
                    }
                }
            }
            SupervisedState::Runs { since, dog } => {
                for _ in self.passed_on..agent.requests() {
                    agent.ask_to_end();
                }
                self.passed_on = agent.requests();
                match agent.ended() {
                    Some(ended) => (*since, Some(ended)),
                    None => {
                        watch(agent, dog, now);
                        return false;
                    }
                }
            }
        };
        if let Some(ended) = &ended {
            agent.note(&format!("the agent {}", ended.how));
        }
        if ended.is_some_and(|ended| ended.is_success) || agent.requests() > 0 {
            agent.note("ending");
            return true;
        }
        self.pause = next_pause(self.pause, now.duration_since(begun));
        agent.note(&format!("restarting the agent in {} s", self.pause.as_secs_f64()));
        self.state = SupervisedState::Pauses { until: now + self.pause };
        false
    }
}

/// Notes the process of an agent that starts: with `write`, or over the note of the agent before with `overwrite`, which needs
/// no room on the disk. A full disk does not keep a vehicle on the ground. Returns why `write` failed, if it did.
///
/// # Errors
/// If `overwrite` fails too.
pub fn note_agent(
    write: impl FnOnce() -> Result<(), String>,
    overwrite: impl FnOnce() -> Result<(), String>,
) -> Result<Option<String>, String> {
    let failed = write().err();
    if failed.is_some() {
        overwrite()?;
    }
    Ok(failed)
}

/// Watches the reports of the agent from now on, if they can be received.
fn listen(agent: &mut impl Supervised, now: Instant) -> Option<Watchdog> {
    match agent.listen() {
        Ok(()) => Some(Watchdog::new(now)),
        Err(error) => {
            agent.note(&format!("an agent that hangs is not noticed: {error}"));
            None
        }
    }
}

/// Kills the agent if it hangs.
fn watch(agent: &mut impl Supervised, dog: &mut Option<Watchdog>, now: Instant) {
    let Some(silent) = dog.as_mut().and_then(|dog| dog.silent_for(now, agent.has_reported())) else { return };
    agent.note(&format!("the agent hangs: silent for {:.0} s; it is killed", silent.as_secs_f64()));
    agent.kill();
    *dog = None;
}

/// Returns the pause before the next restart, from the last pause and the time that the agent has run.
fn next_pause(last: Duration, flown: Duration) -> Duration {
    if flown > STABLE { FIRST_PAUSE } else { (2 * last).clamp(FIRST_PAUSE, LONGEST_PAUSE) }
}

#[cfg(test)]
mod tests {
    use skein_host::clock;

    use super::*;

    #[test]
    fn pauses_grow_while_agents_fail_soon_after_their_start() {
        let young = Duration::from_secs(1);
        let mut pause = Duration::ZERO;
        let mut pauses_s = Vec::new();
        for _ in 0..7 {
            pause = next_pause(pause, young);
            pauses_s.push(pause.as_secs_f64());
        }
        assert_eq!(pauses_s, [0.5, 1.0, 2.0, 4.0, 8.0, 10.0, 10.0]);
        assert_eq!(next_pause(pause, Duration::from_secs(61)), FIRST_PAUSE);
    }

    /// An agent in a test: what it does next, and what the supervisor did.
    #[derive(Default)]
    struct Scripted {
        fails_to_start: bool,
        runs: bool,
        is_killed: bool,
        is_success: bool,
        requests: u32,
        done: Vec<String>,
    }

    impl Supervised for Scripted {
        fn listen(&mut self) -> Result<(), String> {
            Ok(())
        }

        fn start(&mut self) -> Result<(), String> {
            self.done.push("start".to_owned());
            self.runs = !self.fails_to_start;
            if self.runs { Ok(()) } else { Err("no program".to_owned()) }
        }

        fn ended(&mut self) -> Option<AgentEnd> {
            let how = if self.is_killed { "was killed" } else { "ended" };
            (!self.runs).then(|| AgentEnd { is_success: self.is_success, how: how.to_owned() })
        }

        fn has_reported(&mut self) -> bool {
            false
        }

        fn kill(&mut self) {
            (self.runs, self.is_killed) = (false, true);
        }

        fn ask_to_end(&mut self) {
            self.done.push("asked to end".to_owned());
        }

        fn requests(&self) -> u32 {
            self.requests
        }

        fn note(&mut self, what: &str) {
            self.done.push(what.to_owned());
        }
    }

    /// Polls until the work is over or this time has passed; returns whether it is over, and what the supervisor did.
    fn poll(supervision: &mut Supervision, agent: &mut Scripted, now: &mut Instant, for_s: f64) -> (bool, Vec<String>) {
        let until = *now + Duration::from_secs_f64(for_s);
        let mut is_over = false;
        while *now < until && !is_over {
            is_over = supervision.poll(agent, *now);
            *now += POLL_PERIOD;
        }
        (is_over, std::mem::take(&mut agent.done))
    }

    #[test]
    fn an_agent_is_restarted_after_a_failure_and_left_alone_after_a_success() {
        let (mut supervision, mut agent, mut now) = (Supervision::default(), Scripted::default(), clock::now());
        assert_eq!(poll(&mut supervision, &mut agent, &mut now, 1.0), (false, vec!["start".to_owned()]));
        agent.runs = false;
        let done = ["the agent ended", "restarting the agent in 0.5 s", "start"].map(str::to_owned);
        assert_eq!(poll(&mut supervision, &mut agent, &mut now, 0.6), (false, done.to_vec()));
        (agent.runs, agent.is_success) = (false, true);
        let done = ["the agent ended", "ending"].map(str::to_owned);
        assert_eq!(poll(&mut supervision, &mut agent, &mut now, 1.0), (true, done.to_vec()));
    }

    #[test]
    fn an_agent_that_never_reports_is_killed_and_restarted() {
        let (mut supervision, mut agent, mut now) = (Supervision::default(), Scripted::default(), clock::now());
        let (is_over, done) = poll(&mut supervision, &mut agent, &mut now, 61.0);
        let expected = ["start", "the agent hangs: silent for 60 s; it is killed", "the agent was killed"];
        assert!(!is_over);
        assert_eq!(done[..3], expected);
        assert_eq!(done[3..], ["restarting the agent in 0.5 s", "start"]);
    }

    #[test]
    fn a_request_to_end_is_passed_on_and_ends_a_pause() {
        let (mut supervision, mut agent, mut now) = (Supervision::default(), Scripted::default(), clock::now());
        poll(&mut supervision, &mut agent, &mut now, 1.0);
        agent.requests = 2;
        let done = vec!["asked to end".to_owned(); 2];
        assert_eq!(poll(&mut supervision, &mut agent, &mut now, 1.0), (false, done), "each request once");

        let (mut supervision, mut agent) =
            (Supervision::default(), Scripted { fails_to_start: true, ..Scripted::default() });
        poll(&mut supervision, &mut agent, &mut now, 0.1);
        agent.requests = 1;
        assert_eq!(poll(&mut supervision, &mut agent, &mut now, 1.0), (true, vec!["ending".to_owned()]));
    }

    #[test]
    fn a_full_disk_does_not_keep_an_agent_from_starting() {
        let full = || Err("full".to_owned());
        assert_eq!(note_agent(|| Ok(()), || panic!("not needed")), Ok(None));
        assert_eq!(note_agent(full, || Ok(())), Ok(Some("full".to_owned())));
        assert_eq!(note_agent(full, || Err("no note".to_owned())), Err("no note".to_owned()));
    }
}
