//! REST: lists, values, commands and flights.

use std::sync::Arc;

use axum::body::Bytes;
use axum::extract::{DefaultBodyLimit, Path, Query, Request as HttpRequest, State, WebSocketUpgrade};
use axum::http::StatusCode;
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use serde_json::{Value as Js, json};
use tokio::time::{Duration, Instant, timeout};

use super::{Fault, MAX_BODY, REQUEST_WITHIN, WebState, check_index, elements, flight, socket};
use crate::plant::xplane::server::{COMMANDS, DATAREFS, Dataref, Task, Version};

type Api = State<Arc<WebState>>;
type Pairs = Query<Vec<(String, String)>>;
type Reply = Result<Json<Js>, Fault>;

/// All addresses. Version 1 has no commands, and only version 3 has flights.
pub(super) fn router(shared: Arc<WebState>) -> Router {
    let mut router = Router::new().route("/api/capabilities", get(capabilities));
    for version in 1..=3 {
        let at = |path: &str| format!("/api/v{version}{path}");
        router = router
            .route(&at(""), get(upgrade))
            .route(&at("/datarefs"), get(datarefs))
            .route(&at("/datarefs/count"), get(count_datarefs))
            .route(&at("/datarefs/{id}/value"), get(read).patch(write));
        if version >= 2 {
            router = router
                .route(&at("/commands"), get(commands))
                .route(&at("/commands/count"), get(count_commands))
                .route(&at("/command/{id}/activate"), post(activate));
        }
    }
    router
        .route("/api/v3/flight", post(start).patch(update))
        .fallback(async || Fault::missing("not_found", "No such address"))
        .layer(DefaultBodyLimit::max(MAX_BODY))
        .layer(middleware::from_fn_with_state(Arc::clone(&shared), guard))
        .with_state(shared)
}

/// Refuses everything if incoming connections are off, and ends what takes too long.
async fn guard(State(shared): Api, request: HttpRequest, next: Next) -> Response {
    if !shared.accepts {
        return Fault::new(StatusCode::FORBIDDEN, "forbidden", "Incoming traffic is disabled").into_response();
    }
    timeout(REQUEST_WITHIN, next.run(request)).await.unwrap_or_else(|_| StatusCode::REQUEST_TIMEOUT.into_response())
}

async fn capabilities() -> Json<Js> {
    let number = Version::V12.internal();
    let version = format!("{}.{}.{}", number / 10_000, number / 1_000 % 10, number / 100 % 10);
    Json(json!({ "api": { "versions": ["v1", "v2", "v3"] }, "x-plane": { "version": version } }))
}

async fn upgrade(State(shared): Api, socket: WebSocketUpgrade) -> Result<Response, Fault> {
    let Ok(place) = Arc::clone(&shared.sockets).try_acquire_owned() else {
        return Err(Fault::new(StatusCode::SERVICE_UNAVAILABLE, "too_many", "Too many WebSockets are open"));
    };
    let socket = socket.max_message_size(MAX_BODY).max_frame_size(MAX_BODY);
    Ok(socket.on_upgrade(async move |socket| {
        socket::serve(socket, shared).await;
        drop(place);
    }))
}

/// A page of a list: entries by name, by position, with the wanted fields.
fn page(all: Vec<Js>, pairs: &[(String, String)], missing: impl Fn(&str) -> Fault) -> Reply {
    let of = |key: &'static str| pairs.iter().filter(move |(name, _)| name == key).map(|(_, value)| value.as_str());
    let mut listed = all;
    if of("filter[name]").next().is_some() {
        for name in of("filter[name]") {
            if !listed.iter().any(|entry| entry["name"] == name) {
                return Err(missing(name));
            }
        }
        listed.retain(|entry| of("filter[name]").any(|name| entry["name"] == name));
    }
    let number = |key: &'static str, fault: Fault| match of(key).next() {
        None => Ok(None),
        Some(text) => text.parse::<usize>().map(Some).map_err(|_| fault),
    };
    let start_fault = || Fault::bad("start_out_of_range", "Start out of range");
    let limit_fault = || Fault::bad("limit_out_of_range", "Limit out of range");
    if let Some(start) = number("start", start_fault())? {
        if start >= listed.len() {
            return Err(start_fault());
        }
        listed.drain(..start);
    }
    if let Some(limit) = number("limit", limit_fault())? {
        if limit == 0 {
            return Err(limit_fault());
        }
        listed.truncate(limit);
    }
    if let Some(fields) = of("fields").next().filter(|fields| *fields != "all") {
        let fields: Vec<&str> = fields.split(',').collect();
        for entry in &mut listed {
            let Some(object) = entry.as_object_mut() else { continue };
            if let Some(unknown) = fields.iter().find(|field| !object.contains_key(**field)) {
                return Err(Fault::bad("invalid_field", format!("Field {unknown} does not exist")));
            }
            object.retain(|key, _| fields.contains(&key.as_str()));
        }
    }
    Ok(Json(json!({ "data": listed })))
}

async fn datarefs(State(shared): Api, Query(pairs): Pairs) -> Reply {
    let entry = |(at, dataref): (usize, &Dataref)| {
        json!({
            "id": shared.dataref_id(at),
            "name": dataref.path,
            "value_type": dataref.value_type,
            "is_writable": dataref.is_writable(),
        })
    };
    let all = DATAREFS.iter().enumerate().filter(|(_, dataref)| dataref.is_in(&shared.acf));
    let all = all.map(entry).collect();
    page(all, &pairs, |name| Fault::missing("invalid_dataref_name", format!("Dataref {name} doesn't exist")))
}

async fn count_datarefs(State(shared): Api) -> Reply {
    let all = DATAREFS.iter().filter(|dataref| dataref.is_in(&shared.acf));
    Ok(Json(json!({ "data": all.count() })))
}

async fn commands(State(shared): Api, Query(pairs): Pairs) -> Reply {
    let all = COMMANDS.iter().enumerate();
    let all = all.map(|(at, command)| {
        json!({ "id": shared.command_id(at), "name": command.path, "description": command.description })
    });
    page(all.collect(), &pairs, |name| Fault::missing("invalid_command_name", format!("Command {name} doesn't exist")))
}

async fn count_commands() -> Reply {
    Ok(Json(json!({ "data": COMMANDS.len() })))
}

/// The dataref of an address, and the index of its query.
fn addressed(
    shared: &WebState,
    id: &str,
    pairs: &[(String, String)],
) -> Result<(usize, &'static Dataref, Option<usize>), Fault> {
    let (at, dataref) = shared.dataref(id)?;
    let index = pairs.iter().find(|(key, _)| key == "index");
    let wrong = |_| Fault::bad("index_out_of_range", "Dataref array index out of range");
    let index = index.map(|(_, text)| text.parse().map_err(wrong)).transpose()?;
    Ok((at, dataref, check_index(dataref, index, "Dataref")?))
}

async fn read(State(shared): Api, Path(id): Path<String>, Query(pairs): Pairs) -> Reply {
    let (at, _, index) = addressed(&shared, &id, &pairs)?;
    let values = shared.run(Task::Read(vec![(at, index.map(|index| [index].into()))])).await?;
    let value = values.first().map(|value| if index.is_some() { &value[0] } else { value });
    Ok(Json(json!({ "data": value })))
}

/// The body of a request, which has to be a JSON object.
fn body_of(bytes: &Bytes) -> Result<Js, Fault> {
    let invalid = || Fault::bad("invalid_body", "The request body is not valid JSON");
    serde_json::from_slice::<Js>(bytes).ok().filter(Js::is_object).ok_or_else(invalid)
}

async fn write(State(shared): Api, Path(id): Path<String>, Query(pairs): Pairs, bytes: Bytes) -> Reply {
    let (at, dataref, index) = addressed(&shared, &id, &pairs)?;
    let body = body_of(&bytes)?;
    let writes = elements(dataref, index, &body["data"])?;
    shared.run(Task::Write(writes.into_iter().map(|(element, value)| (at, element, value)).collect())).await?;
    Ok(Json(Js::Null))
}

async fn activate(State(shared): Api, Path(id): Path<String>, bytes: Bytes) -> Reply {
    let command = shared.command(&id)?;
    let body = body_of(&bytes)?;
    let duration_s = body["duration"].as_f64();
    let duration_s = duration_s.ok_or_else(|| Fault::bad("duration_missing", "Missing duration parameter"))?;
    if !(0.0..=10.0).contains(&duration_s) {
        return Err(Fault::bad("duration_out_of_range", "Duration is out of valid range"));
    }
    let until = Instant::now() + Duration::from_secs_f64(duration_s);
    let begins = shared.active.lock().hold(0, command, Some(until));
    if begins {
        shared.run(Task::Run(COMMANDS[command].action)).await?;
    }
    Ok(Json(Js::Null))
}

async fn start(State(shared): Api, bytes: Bytes) -> Reply {
    let flight = flight::started(&body_of(&bytes)?["data"], &shared.acf)?;
    shared.run(Task::Fly(flight)).await?;
    Ok(Json(json!({ "error_code": "success" })))
}

async fn update(State(shared): Api, bytes: Bytes) -> Reply {
    let flight = flight::changed(&body_of(&bytes)?["data"])?;
    shared.run(Task::Fly(flight)).await?;
    Ok(Json(json!({ "error_code": "success" })))
}
