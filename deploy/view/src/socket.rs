//! One page at a WebSocket: what it is sent of a live swarm, and what it asks for.
//!
//! A page receives the newest snapshot whenever it has taken in the one before: a slow page misses snapshots, and none waits in
//! memory for it. A page that takes nothing in for some seconds is disconnected.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{Message, WebSocket};
use serde::Deserialize;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, timeout};

use super::events::EventMessage;
use super::field::Field;
use super::live::Frame;
use super::orders::{PageOrder, Rule};
use super::snapshot::LARGE;
use super::{live, orders};

/// Longest time that a slow page may take to receive a message.
const SENT_WITHIN: Duration = Duration::from_secs(5);
/// Shortest time between two fields for a page.
const FIELD_EVERY: Duration = Duration::from_millis(500);
/// Largest number of vehicles with details in a large swarm.
const MOST_DETAILS: usize = 64;
/// Largest number of orders of a page that are not answered yet.
const MOST_ORDERS: usize = 4;

/// A request of a page.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub(super) enum Ask {
    /// The vehicles whose details it shows, of a large swarm.
    Detail {
        /// Their ids.
        vehicles: Vec<String>,
    },
    /// The formation field around a vehicle; `None` ends it.
    Field {
        /// Its id.
        vehicle: Option<String>,
    },
    /// Play the recording from this time on.
    Play {
        /// Time of the recording, s.
        at_s: f64,
        /// Seconds of the recording in a second; 0 shows one instant.
        speed: f64,
    },
    /// An order to the swarm.
    Order(PageOrder),
}

impl Ask {
    /// Parses a page's message; `None` if this server does not know it.
    pub(super) fn parse(text: &str) -> Option<Self> {
        serde_json::from_str(text).ok()
    }
}

/// The wishes of a page for its next snapshots.
#[derive(Debug, Default)]
pub(super) struct Wishes {
    /// The vehicles whose details it shows.
    pub(super) detail: BTreeSet<String>,
    /// The vehicle whose field it shows.
    pub(super) field_of: Option<String>,
    /// The field that was computed last, and when.
    field: Option<(Option<Field>, Instant)>,
}

impl Wishes {
    /// Takes in a request that is not about playing, and not an order.
    pub(super) fn take(&mut self, ask: Ask) {
        match ask {
            Ask::Detail { vehicles } => self.detail = vehicles.into_iter().take(MOST_DETAILS).collect(),
            Ask::Field { vehicle } => (self.field_of, self.field) = (vehicle, None),
            Ask::Play { .. } | Ask::Order(_) => {}
        }
    }

    /// The field that belongs to the next snapshot, at most two new ones a second.
    pub(super) fn field(&mut self, compute: impl FnOnce(&str) -> Option<Field>) -> Option<&Option<Field>> {
        let of = self.field_of.as_deref()?;
        if self.field.as_ref().is_none_or(|(_, at)| at.elapsed() >= FIELD_EVERY) {
            self.field = Some((compute(of), Instant::now()));
        }
        self.field.as_ref().map(|(field, _)| field)
    }
}

/// The next request of a page; `None` if the page is gone. A message that this server does not know is passed over.
pub(super) async fn next(socket: &mut WebSocket) -> Option<Ask> {
    loop {
        match socket.recv().await?.ok()? {
            Message::Text(text) => match Ask::parse(&text) {
                None => {}
                known => return known,
            },
            Message::Binary(_) | Message::Ping(_) | Message::Pong(_) => {}
            Message::Close(_) => return None,
        }
    }
}

/// Sends a message; `None` if the page is gone or too slow.
pub(super) async fn send(socket: &mut WebSocket, message: Message) -> Option<()> {
    timeout(SENT_WITHIN, socket.send(message)).await.ok()?.ok()
}

/// Serves a page that watches a live swarm, until it ends or is too slow: then `None`. The page gives orders by this rule.
pub(super) async fn serve(
    mut socket: WebSocket,
    mut frames: watch::Receiver<Arc<Frame>>,
    rule: Option<Arc<Rule>>,
) -> Option<()> {
    let mut page = LivePage::default();
    let mut given = JoinSet::new();
    frames.mark_changed();
    loop {
        tokio::select! {
            changed = frames.changed() => {
                changed.ok()?;
                let frame = Arc::clone(&frames.borrow_and_update());
                for message in page.messages(&frame) {
                    send(&mut socket, message).await?;
                }
            }
            Some(answer) = given.join_next() => {
                if let Ok(answer) = answer {
                    send(&mut socket, Message::text(answer)).await?;
                }
            }
            ask = next(&mut socket) => match ask? {
                Ask::Order(_) if given.len() >= MOST_ORDERS => {
                    let text = "too many orders at once: wait for the answer to one";
                    send(&mut socket, Message::text(orders::answer(text, false))).await?;
                }
                Ask::Order(order) => {
                    let place = frames.borrow().place.clone();
                    given.spawn(orders::give(rule.clone(), place, order));
                }
                ask => page.wishes.take(ask),
            },
        }
    }
}

/// A page, and what it has been sent.
#[derive(Debug, Default)]
struct LivePage {
    wishes: Wishes,
    hello: Option<u64>,
    problem: Option<live::Problem>,
    /// Number of the next event.
    next_event: u64,
}

impl LivePage {
    /// The messages that bring the page up to this frame.
    fn messages(&mut self, frame: &Frame) -> Vec<Message> {
        let mut messages = Vec::new();
        if let Some((hello, number)) = frame.hello.as_ref().filter(|(_, number)| self.hello != Some(*number)) {
            self.hello = Some(*number);
            messages.push(Message::Text(hello.clone()));
            let (past, next) = frame.events.since(0, frame.zero);
            self.next_event = next;
            messages.push(Message::text(EventMessage::Events { events: past }.to_json()));
        }
        if frame.problem != self.problem {
            self.problem.clone_from(&frame.problem);
            messages.push(Message::text(live::problem_message(frame.problem.as_ref())));
        }
        let Some(snapshot) = frame.snapshot.as_ref().filter(|_| self.hello.is_some()) else { return messages };
        let (new, next) = frame.events.since(self.next_event, frame.zero);
        self.next_event = next;
        messages.extend(new.into_iter().map(|event| Message::text(EventMessage::Event(event).to_json())));
        if let Some(places) = &frame.places {
            messages.push(Message::Binary(places.clone()));
        }
        let detail = self.wishes.detail.clone();
        let field = self.wishes.field(|of| frame.field(of));
        let is_common = snapshot.vehicles.len() <= LARGE && field.is_none();
        messages.push(match &frame.json {
            Some(json) if is_common => Message::Text(json.clone()),
            _ => Message::text(snapshot.to_json(&detail, field)),
        });
        messages
    }
}
