//! `--foxglove`: the server that Foxglove connects to, for a live swarm or a recording. Its channels are those of recordings, so
//! that one layout shows both; its parameters are the keys of the scenario.
//!
//! | module | what it does |
//! | --- | --- |
//! | `live` | publishes what the vehicles of a live swarm send |
//! | `playback` | plays a recording: pause, seek and speed are Foxglove's own |

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use foxglove::websocket::{
    AnyClient, Capability, ChannelView, Client, GetParametersResponder, Parameter, ParameterHandler, ParameterType,
    ParameterValue, PlaybackControlRequest, PlaybackState, ServerListener, SetParametersResponder,
};
use foxglove::{Context, PartialMetadata, RawChannel, Schema, WebSocketServerHandle};
use skein_common::scenario::Described;
use skein_lab::error::Error;
use skein_lab::record::{RecordError, Sink};
use tokio::runtime::Runtime;

mod live;
mod playback;

pub(super) use live::Live;
use playback::Playback;
pub(super) use playback::play;

/// Number of messages that wait for a slow client; then the oldest are dropped.
const BACKLOG: usize = 16_384;

/// Reads `[ADDR:]PORT`; without an address, the loopback.
///
/// # Errors
/// If it is neither.
pub(super) fn address(text: &str) -> Result<SocketAddr, String> {
    let port = text.parse().map(|port: u16| SocketAddr::from((Ipv4Addr::LOCALHOST, port)));
    port.or_else(|_| text.parse())
        .map_err(|_| "a port such as 8765, or an address with a port such as 0.0.0.0:8765".to_owned())
}

/// A running server; it serves until the process ends.
struct Server {
    handle: WebSocketServerHandle,
    context: Arc<Context>,
    readers: Arc<Readers>,
    parameters: Arc<Parameters>,
    _runtime: Runtime,
}

impl Server {
    /// Starts a server with this name; with a playback it plays a recording of that time span.
    fn start(address: SocketAddr, name: String, playback: Option<Arc<Mutex<Playback>>>) -> Result<Self, Error> {
        let failed = |error: &dyn std::fmt::Display| {
            Error::Refused(format!("--foxglove {address}: {error}; choose another port"))
        };
        let mut runtime = tokio::runtime::Builder::new_multi_thread();
        let runtime =
            runtime.worker_threads(1).thread_name("foxglove").enable_all().build().map_err(|error| failed(&error))?;
        let (context, parameters) = (Context::new(), Arc::new(Parameters::default()));
        let host = match address.ip() {
            IpAddr::V4(ip) => ip.to_string(),
            IpAddr::V6(ip) => format!("[{ip}]"),
        };
        let mut server = context.websocket_server().name(name).bind(host, address.port()).message_backlog_size(BACKLOG);
        server = server.tokio_runtime(runtime.handle()).parameter_handler(Arc::clone(&parameters) as _);
        if let Some(playback) = &playback {
            let (first_ns, last_ns) = lock(playback).span_ns;
            server = server.playback_time_range(first_ns, last_ns).capabilities([Capability::Time]);
        }
        let readers = Arc::new(Readers { playback, ..Readers::default() });
        server = server.listener(Arc::clone(&readers) as _);
        let handle = runtime.block_on(server.start()).map_err(|error| failed(&error))?;
        Ok(Self { handle, context, readers, parameters, _runtime: runtime })
    }

    /// A sink whose channels this server offers.
    fn sink(&self) -> ServerSink {
        ServerSink { context: Arc::clone(&self.context), schemas: Vec::new(), channels: Vec::new() }
    }
}

/// The channels that a server offers; dropped, they are offered no more.
struct ServerSink {
    context: Arc<Context>,
    schemas: Vec<Schema>,
    channels: Vec<Arc<RawChannel>>,
}

impl Sink for ServerSink {
    fn add_schema(&mut self, name: &str, encoding: &str, data: &[u8]) -> Result<u16, RecordError> {
        self.schemas.push(Schema::new(name, encoding, data.to_vec()));
        number(self.schemas.len())
    }

    fn add_channel(&mut self, topic: &str, schema: u16, encoding: &str) -> Result<u16, RecordError> {
        let schema = self.schemas.get(usize::from(schema)).cloned();
        let channel = self.context.channel_builder(topic).schema(schema).message_encoding(encoding);
        self.channels.push(channel.build_raw().map_err(|_| RecordError::Missing("the encoding of a channel"))?);
        number(self.channels.len())
    }

    fn is_read(&self, channel: u16) -> bool {
        self.channels.get(usize::from(channel)).is_some_and(|channel| channel.has_sinks())
    }

    fn put(&mut self, channel: u16, log_time_ns: u64, message: &[u8]) {
        if let Some(channel) = self.channels.get(usize::from(channel)) {
            channel.log_with_meta(message, PartialMetadata::with_log_time(log_time_ns));
        }
    }
}

impl Drop for ServerSink {
    fn drop(&mut self) {
        self.channels.iter().for_each(|channel| channel.close());
    }
}

/// The number of the last of so many.
fn number(count: usize) -> Result<u16, RecordError> {
    u16::try_from(count.saturating_sub(1)).map_err(|_| RecordError::Missing("a number for another channel"))
}

/// Notes what clients ask for. The server calls it, and must not wait for it.
#[derive(Default)]
struct Readers {
    /// Number of subscriptions of all clients.
    subscriptions: AtomicUsize,
    /// Whether there was a new subscription since the last look.
    has_new: AtomicBool,
    /// Whether a client has connected since the last look.
    has_connected: AtomicBool,
    playback: Option<Arc<Mutex<Playback>>>,
}

impl Readers {
    /// Whether any client reads a channel.
    fn are_any(&self) -> bool {
        self.subscriptions.load(Relaxed) > 0
    }

    /// Whether there was a new subscription since this was asked last.
    fn take_new(&self) -> bool {
        self.has_new.swap(false, Relaxed)
    }
}

impl ServerListener for Readers {
    fn on_subscribe(&self, _: Client, _: ChannelView) {
        self.subscriptions.fetch_add(1, Relaxed);
        self.has_new.store(true, Relaxed);
    }

    fn on_unsubscribe(&self, _: Client, _: ChannelView) {
        self.subscriptions.fetch_sub(1, Relaxed);
    }

    fn on_client_connect(&self) {
        self.has_connected.store(true, Relaxed);
    }

    fn on_playback_control_request(&self, request: PlaybackControlRequest) -> Option<PlaybackState> {
        self.playback.as_ref().map(|playback| lock(playback).control(&request))
    }
}

/// The keys of the scenario, which clients can read.
#[derive(Default)]
struct Parameters(Mutex<Vec<Parameter>>);

impl Parameters {
    /// Shows the keys of this scenario.
    fn show(&self, described: &Described) {
        let lines = described.first().explain().iter();
        *lock(&self.0) = lines.filter_map(|line| parameter(&line.key, line.value.as_ref()?)).collect();
    }

    /// The parameters with these names; all, if there is no name.
    fn named(&self, names: &[String]) -> Vec<Parameter> {
        let is_named = |parameter: &&Parameter| names.is_empty() || names.contains(&parameter.name);
        lock(&self.0).iter().filter(is_named).cloned().collect()
    }
}

/// No holder can panic, so poisoning is ignored.
fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

impl ParameterHandler for Parameters {
    fn get(&self, _: AnyClient, names: Vec<String>, _: Option<String>, responder: GetParametersResponder) {
        responder.respond(self.named(&names));
    }

    fn set(&self, client: AnyClient, to: Vec<Parameter>, _: Option<String>, responder: SetParametersResponder) {
        client.send_warning("the keys of the scenario can be read here, not changed: edit the file and fly again");
        let names: Vec<String> = to.into_iter().map(|parameter| parameter.name).collect();
        responder.respond(if names.is_empty() { Vec::new() } else { self.named(&names) });
    }
}

/// A key with its value in TOML.
fn parameter(key: &str, value: &str) -> Option<Parameter> {
    let value: toml::Value = value.parse().ok()?;
    let r#type = matches!(value, toml::Value::Float(_)).then_some(ParameterType::Float64);
    Some(Parameter { name: key.to_owned(), r#type, value: Some(parameter_value(value)) })
}

fn parameter_value(value: toml::Value) -> ParameterValue {
    match value {
        toml::Value::Integer(number) => ParameterValue::Integer(number),
        toml::Value::Float(number) => ParameterValue::Float64(number),
        toml::Value::Boolean(truth) => ParameterValue::Bool(truth),
        toml::Value::String(text) => ParameterValue::String(text),
        toml::Value::Datetime(time) => ParameterValue::String(time.to_string()),
        toml::Value::Array(values) => ParameterValue::Array(values.into_iter().map(parameter_value).collect()),
        toml::Value::Table(values) => {
            ParameterValue::Dict(values.into_iter().map(|(key, value)| (key, parameter_value(value))).collect())
        }
    }
}

#[cfg(test)]
mod tests;
