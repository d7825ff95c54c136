//! WebSocket: subscriptions, ten updates a second of what has changed, and commands that are held down.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use axum::extract::ws::{Message, WebSocket};
use serde_json::{Map, Value as Json, json};
use tokio::time::{Duration, Instant, MissedTickBehavior, interval, timeout};

use super::{Fault, WebState, check_index, elements};
use crate::plant::xplane::server::{COMMANDS, Dataref, Elements, Task};

/// Time between two updates, and longest time that a slow client may take to receive one.
const UPDATE_EVERY: Duration = Duration::from_millis(100);
const SENT_WITHIN: Duration = Duration::from_secs(5);
/// Longest time that a command is held down without being released, s.
const LONGEST_HOLD_S: f64 = 24.0 * 3600.0;

/// The subscriptions of one client, and the values that it was sent last.
struct Session {
    shared: Arc<WebState>,
    connection: u64,
    /// Numbers of this start of the simulator: after a restart the client has to connect again.
    first_id: u64,
    /// Datarefs with the elements wanted of each.
    datarefs: BTreeMap<usize, Elements>,
    commands: BTreeSet<usize>,
    sent: Map<String, Json>,
    sent_active: Map<String, Json>,
}

/// Serves one client until it ends, is too slow, or the simulator ends.
pub(super) async fn serve(mut socket: WebSocket, shared: Arc<WebState>) {
    let connection = shared.active.lock().connect();
    let mut session = Session {
        first_id: shared.first_id(),
        connection,
        datarefs: BTreeMap::new(),
        commands: BTreeSet::new(),
        sent: Map::new(),
        sent_active: Map::new(),
        shared: Arc::clone(&shared),
    };
    let mut updates = interval(UPDATE_EVERY);
    updates.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        let messages = tokio::select! {
            message = socket.recv() => match message {
                Some(Ok(Message::Text(text))) => vec![session.answer(&text).await],
                Some(Ok(Message::Binary(bytes))) => vec![session.answer(&String::from_utf8_lossy(&bytes)).await],
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => Vec::new(),
                Some(Ok(Message::Close(_)) | Err(_)) | None => break,
            },
            _ = updates.tick() => match session.updates().await {
                Some(updates) => updates,
                None => break,
            },
        };
        let mut is_sent = true;
        for message in messages {
            let sending = socket.send(Message::text(message.to_string()));
            is_sent &= matches!(timeout(SENT_WITHIN, sending).await, Ok(Ok(())));
        }
        if !is_sent {
            break;
        }
    }
    shared.active.lock().disconnect(connection);
}

impl Session {
    /// Carries out a request and returns its result.
    async fn answer(&mut self, text: &str) -> Json {
        let Ok(request) = serde_json::from_str::<Json>(text) else {
            return result(&Json::Null, Err(Fault::bad("invalid_body", "The message is not valid JSON")));
        };
        let outcome = self.carry_out(&request).await;
        result(&request["req_id"], outcome)
    }

    async fn carry_out(&mut self, request: &Json) -> Result<(), Fault> {
        let params = &request["params"];
        match request["type"].as_str().unwrap_or_default() {
            "dataref_subscribe_values" => {
                for (at, wanted) in self.wanted(params)? {
                    self.sent.remove(&self.shared.dataref_id(at).to_string());
                    let elements = self.datarefs.entry(at).or_insert_with(|| Some(BTreeSet::new()));
                    match (wanted, elements) {
                        (Some(wanted), Some(elements)) => elements.extend(wanted),
                        (_, elements) => *elements = None,
                    }
                }
                Ok(())
            }
            "dataref_unsubscribe_values" if params["datarefs"] == "all" => {
                self.datarefs.clear();
                Ok(())
            }
            "dataref_unsubscribe_values" => {
                for (at, unwanted) in self.wanted(params)? {
                    let left = match (unwanted, self.datarefs.get(&at)) {
                        (Some(unwanted), Some(Some(elements))) => elements.difference(&unwanted).copied().collect(),
                        _ => BTreeSet::new(),
                    };
                    if left.is_empty() {
                        self.datarefs.remove(&at)
                    } else {
                        self.datarefs.insert(at, Some(left))
                    };
                    self.sent.remove(&self.shared.dataref_id(at).to_string());
                }
                Ok(())
            }
            "dataref_set_values" => self.set(params).await,
            "command_subscribe_is_active" => {
                let commands = self.named(params)?;
                commands.iter().for_each(|&at| {
                    self.sent_active.remove(&self.shared.command_id(at).to_string());
                });
                self.commands.extend(commands);
                Ok(())
            }
            "command_unsubscribe_is_active" if params["commands"] == "all" => {
                self.commands.clear();
                Ok(())
            }
            "command_unsubscribe_is_active" => {
                let commands = self.named(params)?;
                self.commands.retain(|at| !commands.contains(at));
                Ok(())
            }
            "command_set_is_active" => self.hold(params).await,
            other => Err(Fault::bad("unknown_type", format!("Unknown type {other}"))),
        }
    }

    fn dataref(&self, entry: &Json) -> Result<(usize, &'static Dataref), Fault> {
        let number = entry["id"].as_u64();
        let number = number.ok_or_else(|| Fault::bad("invalid_dataref_id", "Dataref without a number"))?;
        self.shared.dataref(&number.to_string())
    }

    /// The datarefs of a subscription with the elements wanted; all of them exist, or none is subscribed to.
    fn wanted(&self, params: &Json) -> Result<Vec<(usize, Elements)>, Fault> {
        let wanted = list(params, "datarefs")?.iter().map(|entry| {
            let (at, dataref) = self.dataref(entry)?;
            let what = format!("Dataref {}", entry["id"]);
            let indices: Vec<Option<u64>> = match &entry["index"] {
                Json::Null => return Ok((at, None)),
                Json::Array(indices) => indices.iter().map(Json::as_u64).collect(),
                index => vec![index.as_u64()],
            };
            let mut elements = BTreeSet::new();
            for index in indices {
                elements.extend(check_index(dataref, Some(index.unwrap_or(u64::MAX)), &what)?);
            }
            Ok((at, Some(elements)))
        });
        wanted.collect()
    }

    async fn set(&self, params: &Json) -> Result<(), Fault> {
        let mut writes = Vec::new();
        for entry in list(params, "datarefs")? {
            let (at, dataref) = self.dataref(entry)?;
            let index = check_index(dataref, entry["index"].as_u64(), &format!("Dataref {}", entry["id"]))?;
            let values = elements(dataref, index, &entry["value"]).map_err(|fault| match fault.code {
                "incompatible_data" => Fault { code: "insufficient_data", ..fault },
                _ => fault,
            })?;
            writes.extend(values.into_iter().map(|(element, value)| (at, element, value)));
        }
        self.shared.run(Task::Write(writes)).await.map(drop)
    }

    /// Positions of the commands of a request.
    fn named(&self, params: &Json) -> Result<Vec<usize>, Fault> {
        list(params, "commands")?.iter().map(|entry| self.command(entry)).collect()
    }

    fn command(&self, entry: &Json) -> Result<usize, Fault> {
        let number = entry["id"].as_u64();
        let number = number.ok_or_else(|| Fault::bad("invalid_command_id", "Command without a number"))?;
        self.shared.command(&number.to_string())
    }

    async fn hold(&self, params: &Json) -> Result<(), Fault> {
        for entry in list(params, "commands")? {
            let command = self.command(entry)?;
            if entry["is_active"] != true {
                self.shared.active.lock().release(self.connection, command);
                continue;
            }
            let until = match entry["duration"].as_f64() {
                Some(duration_s) if !(0.0..=LONGEST_HOLD_S).contains(&duration_s) => {
                    return Err(Fault::bad("duration_out_of_range", "Duration is out of range"));
                }
                Some(duration_s) => Some(Instant::now() + Duration::from_secs_f64(duration_s)),
                None => None,
            };
            let begins = self.shared.active.lock().hold(self.connection, command, until);
            if begins {
                self.shared.run(Task::Run(COMMANDS[command].action)).await?;
            }
        }
        Ok(())
    }

    /// Messages with what has changed since the last ones; `None` if the simulator has ended.
    async fn updates(&mut self) -> Option<Vec<Json>> {
        if self.shared.first_id() != self.first_id {
            return None;
        }
        let mut messages = Vec::new();
        if !self.datarefs.is_empty() {
            let wanted = self.datarefs.iter().map(|(at, elements)| (*at, elements.clone())).collect();
            let values = self.shared.run(Task::Read(wanted)).await.ok()?;
            let ids = self.datarefs.keys().map(|at| self.shared.dataref_id(*at).to_string());
            let all = ids.zip(values).collect();
            messages.extend(changes(&mut self.sent, all, "dataref_update_values"));
        }
        if !self.commands.is_empty() {
            let mut active = self.shared.active.lock();
            let is_held = |&at: &usize| (self.shared.command_id(at).to_string(), Json::from(active.is_held(at)));
            let all: Map<String, Json> = self.commands.iter().map(is_held).collect();
            drop(active);
            messages.extend(changes(&mut self.sent_active, all, "command_update_is_active"));
        }
        Some(messages)
    }
}

/// The message with what differs from what was sent, which is then updated.
fn changes(sent: &mut Map<String, Json>, all: Map<String, Json>, kind: &str) -> Option<Json> {
    let changed: Map<String, Json> = all.into_iter().filter(|(id, value)| sent.get(id) != Some(value)).collect();
    sent.extend(changed.clone());
    (!changed.is_empty()).then(|| json!({ "type": kind, "data": changed }))
}

fn list<'a>(params: &'a Json, key: &str) -> Result<&'a Vec<Json>, Fault> {
    params[key].as_array().ok_or_else(|| Fault::bad("invalid_body", format!("Missing list {key}")))
}

fn result(req_id: &Json, outcome: Result<(), Fault>) -> Json {
    match outcome {
        Ok(()) => json!({ "req_id": req_id, "type": "result", "success": true }),
        Err(Fault { code, message, .. }) => json!({
            "req_id": req_id, "type": "result", "success": false, "error_code": code, "error_message": message,
        }),
    }
}
