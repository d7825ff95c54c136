//! Carries messages from the control thread to the network.
//!
//! The control thread hands over the messages of a step and continues at once: it takes one lock, which is held only
//! for a copy. The publisher's thread signs, encodes and sends. While Zenoh blocks that thread for a slow peer, a
//! waiting state, heartbeat or summary is replaced by the next one, so that the newest is sent. Events and traces wait in
//! queues; when a queue is full, its oldest message is dropped and counted.
//!
//! Traces wait until [`TRACES_AT_ONCE`] of them or another message is to be sent. The cost of sending and receiving is
//! that of waking the threads involved, not of the messages, and no process needs a trace at once.

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use parking_lot::{Condvar, Mutex};
use skein_common::message::{Event, Heartbeat, Intent, State, Summary, Trace};
use skein_common::topic::Cell;

/// Longest queue of events; a vehicle has a handful in a minute.
const MAX_EVENTS: usize = 64;
/// Longest queue of traces: a third of a second at 50 frames a second.
const MAX_TRACES: usize = 16;
/// Number of traces that are sent together: a tenth of a second at 50 frames a second.
const TRACES_AT_ONCE: usize = 5;
/// Time for the publisher's thread to send the waiting messages when it ends.
const END_TIMEOUT: Duration = Duration::from_millis(200);

/// The messages of one step, or those that were handed over and not yet sent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Messages {
    /// The own state, and the cell whose key it is published under.
    pub state: Option<(State, Cell)>,
    /// The own heartbeat, which carries the agreement state.
    pub mission: Option<Heartbeat>,
    /// Events, the oldest first.
    pub events: VecDeque<Event>,
    /// Traces, the oldest first.
    pub traces: VecDeque<Trace>,
    /// Summary after the step.
    pub summary: Option<Summary>,
    /// The intent of the own team, and the cells whose keys it is published under.
    pub intent: Option<(Intent, Vec<Cell>)>,
    /// The cells to subscribe to from now on, if they have changed.
    pub cells: Option<Vec<Cell>>,
}

/// The publisher's thread and its waiting messages.
#[derive(Debug)]
pub(super) struct Outgoing {
    pub(super) shared: Arc<Handover>,
    /// Disconnected when the thread has ended.
    ended: mpsc::Receiver<()>,
}

/// The messages between the two threads.
#[derive(Debug, Default)]
pub(super) struct Handover {
    held: Mutex<Held>,
    handed_over: Condvar,
}

#[derive(Debug, Default)]
struct Held {
    waiting: Messages,
    /// Number of events and traces dropped from a full queue since the start.
    dropped: u64,
    is_over: bool,
}

impl Outgoing {
    /// Starts the thread. It calls `send` whenever messages wait; `send` takes all of them.
    ///
    /// # Errors
    /// If a thread cannot be started.
    pub(super) fn start(mut send: impl FnMut(&mut Messages) + Send + 'static) -> io::Result<Self> {
        let shared = Arc::<Handover>::default();
        let (ending, ended) = mpsc::sync_channel::<()>(1);
        let of_thread = shared.clone();
        thread::Builder::new().name("publisher".to_owned()).spawn(move || {
            let (mut waiting, mut known) = (Messages::default(), 0);
            while let Some(dropped) = of_thread.next(&mut waiting) {
                if dropped > known {
                    known = dropped;
                    tracing::warn!("the network is too slow: {dropped} events and traces were dropped since the start");
                }
                send(&mut waiting);
            }
            drop(send);
            drop(ending);
        })?;
        Ok(Self { shared, ended })
    }

    /// A queue without a thread: a test in virtual time takes the messages itself.
    pub(super) fn without_thread() -> Self {
        Self { shared: Arc::default(), ended: mpsc::channel().1 }
    }

    /// Hands over the messages of one step. Never waits for the network.
    pub(super) fn hand_over(&self, messages: Messages) {
        let is_due = {
            let mut held = self.shared.held.lock();
            held.dropped += held.waiting.add(messages);
            held.waiting.is_due()
        };
        if is_due {
            self.shared.handed_over.notify_one();
        }
    }

    /// Number of events and traces dropped since the start because the network was too slow.
    pub(super) fn dropped(&self) -> u64 {
        self.shared.held.lock().dropped
    }

    /// Ends the thread after the waiting messages are sent, at the latest after [`END_TIMEOUT`].
    pub(super) fn end(&self) {
        self.shared.end();
        let _ = self.ended.recv_timeout(END_TIMEOUT);
    }
}

impl Drop for Outgoing {
    fn drop(&mut self) {
        self.shared.end();
    }
}

impl Handover {
    /// Waits for messages and swaps them for the empty `sent`. Returns the number of dropped messages since the start,
    /// or `None` at the end, when no message waits.
    fn next(&self, sent: &mut Messages) -> Option<u64> {
        let mut held = self.held.lock();
        self.handed_over.wait_while(&mut held, |held| !held.waiting.is_due() && !held.is_over);
        if held.waiting.is_empty() {
            return None;
        }
        std::mem::swap(&mut held.waiting, sent);
        Some(held.dropped)
    }

    /// Swaps the waiting messages for the empty `sent` if they are due, in place of the thread. Returns whether they were.
    pub(super) fn take_due(&self, sent: &mut Messages) -> bool {
        let mut held = self.held.lock();
        let is_due = held.waiting.is_due();
        if is_due {
            std::mem::swap(&mut held.waiting, sent);
        }
        is_due
    }

    /// Number of events and traces that wait.
    pub(super) fn queued(&self) -> (usize, usize) {
        let held = self.held.lock();
        (held.waiting.events.len(), held.waiting.traces.len())
    }

    fn end(&self) {
        self.held.lock().is_over = true;
        self.handed_over.notify_one();
    }
}

impl Messages {
    /// Adds the messages of a later step. Returns how many events and traces were dropped for them.
    fn add(&mut self, later: Self) -> u64 {
        let mut dropped = 0;
        self.state = later.state.or(self.state.take());
        self.mission = later.mission.or(self.mission.take());
        self.summary = later.summary.or(self.summary.take());
        self.intent = later.intent.or(self.intent.take());
        self.cells = later.cells.or(self.cells.take());
        later.events.into_iter().for_each(|event| dropped += push(&mut self.events, event, MAX_EVENTS));
        later.traces.into_iter().for_each(|trace| dropped += push(&mut self.traces, trace, MAX_TRACES));
        dropped
    }

    /// Whether the publisher's thread has to send now.
    fn is_due(&self) -> bool {
        self.traces.len() >= TRACES_AT_ONCE || self.has_more_than_traces()
    }

    /// Whether there are none.
    pub(crate) fn is_empty(&self) -> bool {
        self.traces.is_empty() && !self.has_more_than_traces()
    }

    fn has_more_than_traces(&self) -> bool {
        self.state.is_some()
            || self.mission.is_some()
            || self.cells.is_some()
            || self.intent.is_some()
            || self.summary.is_some()
            || !self.events.is_empty()
    }
}

/// Adds the newest message; returns how many old ones were dropped for it.
fn push<M>(queue: &mut VecDeque<M>, message: M, most: usize) -> u64 {
    let is_full = queue.len() >= most;
    if is_full {
        queue.pop_front();
    }
    queue.push_back(message);
    u64::from(is_full)
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use skein_common::id::{Incarnation, VehicleId, VehicleSet};
    use skein_common::message::{EventKind, Header, VehicleFacts};
    use skein_common::time::{PlantTime, SenderStamp};

    use super::*;
    use skein_host::clock::now;

    fn header(sequence: u64) -> Header {
        let sender = VehicleId::new(1).unwrap();
        Header { sender, incarnation: Incarnation(1), sequence, stamp: SenderStamp::ZERO }
    }

    fn heartbeat(sequence: u64) -> Heartbeat {
        Heartbeat {
            header: header(sequence),
            plan: 7,
            membership: Default::default(),
            step: 0,
            vouched: 0,
            reached: None,
            progress_m: 0.0,
            order: None,
            orders: 0,
            echo: None,
            lost: VehicleSet::default(),
        }
    }

    fn trace(sequence: u64) -> Messages {
        let trace = Trace::new(header(sequence), PlantTime::ZERO, VehicleFacts::default());
        Messages { traces: [trace].into(), ..Messages::default() }
    }

    fn step(sequence: u64) -> Messages {
        let events = [Event { header: header(sequence), what: EventKind::Landed }].into();
        Messages { mission: Some(heartbeat(sequence)), events, ..Messages::default() }
    }

    #[test]
    fn while_the_publisher_is_blocked_the_newest_heartbeat_and_the_last_events_wait() {
        let (begun, has_begun) = mpsc::channel();
        let (let_go, held_up) = mpsc::channel::<()>();
        let (sent, was_sent) = mpsc::channel();
        let outgoing = Outgoing::start(move |waiting| {
            begun.send(()).unwrap();
            held_up.recv().unwrap();
            let registers = waiting.mission.take().map(|message| message.header.sequence);
            sent.send((registers, waiting.events.drain(..).map(|message| message.header.sequence).collect::<Vec<_>>()))
                .unwrap();
        })
        .unwrap();
        outgoing.hand_over(step(1));
        has_begun.recv().unwrap();
        let from: Instant = now();
        let more = MAX_EVENTS as u64 + 6;
        (2..2 + more).for_each(|sequence| outgoing.hand_over(step(sequence)));
        assert!(now() - from < Duration::from_secs(1), "the control thread waited");
        assert_eq!(outgoing.dropped(), 6);
        let_go.send(()).unwrap();
        assert_eq!(was_sent.recv().unwrap(), (Some(1), vec![1]));
        let_go.send(()).unwrap();
        outgoing.end();
        assert_eq!(was_sent.recv().unwrap(), (Some(1 + more), (2 + 6..2 + more).collect()));
    }

    #[test]
    fn traces_wait_for_each_other_or_for_another_message_or_the_end() {
        let (sent, was_sent) = mpsc::channel();
        let outgoing = Outgoing::start(move |waiting| {
            let Messages { mission, traces, .. } = std::mem::take(waiting);
            sent.send((mission.is_some(), traces.len())).unwrap();
        })
        .unwrap();
        let hand_over = |count: usize| (0..count as u64).for_each(|sequence| outgoing.hand_over(trace(sequence)));
        hand_over(TRACES_AT_ONCE - 1);
        assert_eq!(was_sent.recv_timeout(Duration::from_millis(50)), Err(mpsc::RecvTimeoutError::Timeout));
        hand_over(1);
        assert_eq!(was_sent.recv().unwrap(), (false, TRACES_AT_ONCE));
        hand_over(2);
        outgoing.hand_over(Messages { mission: Some(heartbeat(1)), ..Messages::default() });
        assert_eq!(was_sent.recv().unwrap(), (true, 2));
        hand_over(1);
        outgoing.end();
        assert_eq!(was_sent.recv().unwrap(), (false, 1));
    }

    #[test]
    fn waiting_messages_are_sent_at_the_end_unless_the_publisher_is_blocked() {
        let (sent, was_sent) = mpsc::channel();
        let outgoing = Outgoing::start(move |waiting| sent.send(std::mem::take(waiting)).unwrap()).unwrap();
        outgoing.hand_over(step(1));
        outgoing.end();
        assert_eq!(was_sent.try_recv().unwrap().mission, Some(heartbeat(1)));
        assert!(was_sent.recv().is_err(), "the thread has ended");

        let (_let_go, held_up) = mpsc::channel::<()>();
        let outgoing = Outgoing::start(move |_| _ = held_up.recv()).unwrap();
        outgoing.hand_over(step(1));
        let from = now();
        outgoing.end();
        assert!(now() - from < END_TIMEOUT + Duration::from_secs(1));
    }
}
