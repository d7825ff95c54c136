//! One session with a law, over the standard streams of a process, a TCP connection or a UDP socket.
//!
//! Outgoing messages wait in a short queue for a writer thread that may block; a reader thread passes on the incoming
//! ones. The owner of a [`LawSession`] therefore never waits for the law, and a law that sends too much waits for the
//! receiver. At most [`MAX_LINE`] bytes of an unfinished line are kept.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpStream, ToSocketAddrs, UdpSocket};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use super::protocol::{MAX_LINE, MessageToLaw};
use super::vector;
use crate::clock::{now, sleep_until};
use crate::process::in_own_group;

/// Longest queue of outgoing messages. A law that reads no further gets no further queries.
const QUEUE: usize = 1024;
/// Time for a process to end after a bye; then it is killed.
const END_TIMEOUT: Duration = Duration::from_secs(1);
/// Time for the last lines on the standard error of a process that has ended to be passed on.
const LAST_LINES_TIMEOUT: Duration = Duration::from_millis(500);
/// A connection that accepts no data for this long is dead.
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);
/// Interval at which the thread that receives datagrams checks whether the session was closed.
const POLL_PERIOD: Duration = Duration::from_millis(100);

/// Input from a law.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LawInput {
    /// A line without its newline, or a datagram.
    Data(Vec<u8>),
    /// A line that is too long.
    TooLong,
    /// The end of the input.
    End,
}

/// Receives each input and its arrival time; returns false when no further input is needed.
pub trait Sink: FnMut(Instant, LawInput) -> bool + Send + 'static {}
impl<F: FnMut(Instant, LawInput) -> bool + Send + 'static> Sink for F {}

/// A session with a law. Dropping it sends a bye, waits for a process to end and then kills it.
#[derive(Debug)]
pub struct LawSession {
    outbox: Option<SyncSender<Vec<u8>>>,
    partner: Partner,
}

#[derive(Debug)]
enum Partner {
    /// The thread passes on its standard error.
    Process(Child, Option<JoinHandle<()>>),
    /// The thread writes to it.
    Connection(TcpStream, Option<JoinHandle<()>>),
    Datagrams {
        closed: Arc<AtomicBool>,
    },
}

/// The law has stopped reading its messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LawUnresponsive;

impl LawSession {
    /// Starts a process. Each line of its standard error goes to `log`. In its `own_group` the process does not get
    /// the terminal's Ctrl-C.
    ///
    /// # Errors
    /// If the process does not start.
    pub fn process(
        command: &[String],
        own_group: bool,
        sink: impl Sink,
        log: impl Fn(&str) + Send + 'static,
    ) -> io::Result<Self> {
        let (program, arguments) = command.split_first().ok_or(io::ErrorKind::NotFound)?;
        let mut command = Command::new(program);
        command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        if own_group {
            in_own_group(&mut command);
        }
        let mut process = command.spawn()?;
        let pass_on = move |_: Instant, message: LawInput| {
            if let LawInput::Data(line) = message {
                log(String::from_utf8_lossy(&line).trim_end());
            }
            true
        };
        let errors = process.stderr.take().map(|stderr| thread::spawn(move || read_lines(stderr, pass_on)));
        if let Some(stdout) = process.stdout.take() {
            thread::spawn(move || read_lines(stdout, sink));
        }
        let mut stdin = process.stdin.take().ok_or(io::ErrorKind::BrokenPipe)?;
        let (outbox, _) = queue(move |message| stdin.write_all(message).and_then(|()| stdin.flush()));
        Ok(Self { outbox: Some(outbox), partner: Partner::Process(process, errors) })
    }

    /// Starts a session over a connection that a law has made.
    ///
    /// # Errors
    /// If the system gives no second handle to the connection.
    pub fn connection(stream: TcpStream, sink: impl Sink) -> io::Result<Self> {
        stream.set_nonblocking(false)?;
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(WRITE_TIMEOUT))?;
        let (reading, mut writing) = (stream.try_clone()?, stream.try_clone()?);
        thread::spawn(move || read_lines(reading, sink));
        let (outbox, writer) = queue(move |message| writing.write_all(message));
        Ok(Self { outbox: Some(outbox), partner: Partner::Connection(stream, Some(writer)) })
    }

    /// Starts a session over datagrams: messages are sent to `ask`; input from any sender is received at `answer`.
    ///
    /// # Errors
    /// If an address is not valid, or the port cannot be bound.
    pub fn datagrams(ask: (&str, u16), answer: (&str, u16), sink: impl Sink) -> io::Result<Self> {
        let socket = UdpSocket::bind(answer)?;
        socket.set_read_timeout(Some(POLL_PERIOD))?;
        let of_kind = |address: &SocketAddr| socket.local_addr().is_ok_and(|own| own.is_ipv4() == address.is_ipv4());
        let to = ask.to_socket_addrs()?.find(of_kind).ok_or(io::ErrorKind::AddrNotAvailable)?;
        let (reading, closed) = (socket.try_clone()?, Arc::new(AtomicBool::new(false)));
        let of_reader = closed.clone();
        thread::spawn(move || read_datagrams(&reading, &of_reader, sink));
        let (outbox, _) = queue(move |message| {
            // The law may not be up yet.
            let _ = socket.send_to(message, to);
            Ok(())
        });
        Ok(Self { outbox: Some(outbox), partner: Partner::Datagrams { closed } })
    }

    /// Sends a message, without waiting. A law that uses vectors gets only queries.
    ///
    /// # Errors
    /// If the law has stopped reading.
    pub fn send(&self, outgoing: &MessageToLaw<'_>) -> Result<(), LawUnresponsive> {
        let message = match (&self.partner, outgoing) {
            (Partner::Datagrams { .. }, MessageToLaw::LawQuery(ask)) => vector::write(ask),
            (Partner::Datagrams { .. }, _) => return Ok(()),
            _ => outgoing.line(),
        };
        match self.outbox.as_ref().map(|outbox| outbox.try_send(message)) {
            Some(Ok(())) => Ok(()),
            // The law is behind; it does not reply to a query that it does not get.
            Some(Err(TrySendError::Full(_))) => Ok(()),
            Some(Err(TrySendError::Disconnected(_))) | None => Err(LawUnresponsive),
        }
    }

    /// Whether the session uses vectors.
    pub fn uses_vectors(&self) -> bool {
        matches!(self.partner, Partner::Datagrams { .. })
    }

    /// Describes how the law ended.
    pub fn how_it_ended(&mut self) -> String {
        let Partner::Process(process, _) = &mut self.partner else { return "has closed the connection".to_owned() };
        wait_while(END_TIMEOUT, || matches!(process.try_wait(), Ok(None)));
        match process.try_wait() {
            Ok(Some(status)) => format!("has ended ({status})"),
            _ => "has closed its input or its output".to_owned(),
        }
    }

    /// Sends a bye and closes the law's input, which asks the law to end.
    pub fn send_bye(&mut self) {
        let _ = self.send(&MessageToLaw::Bye);
        self.outbox = None;
    }
}

impl Drop for LawSession {
    fn drop(&mut self) {
        self.send_bye();
        match &mut self.partner {
            Partner::Process(process, errors) => {
                wait_while(END_TIMEOUT, || matches!(process.try_wait(), Ok(None)));
                // Its own children may still hold its streams; the threads end when those do.
                let _ = process.kill();
                let _ = process.wait();
                // The last line often says why the process has ended.
                wait_while(LAST_LINES_TIMEOUT, || errors.as_ref().is_some_and(|errors| !errors.is_finished()));
            }
            Partner::Connection(stream, writer) => {
                writer.take().map(JoinHandle::join);
                let _ = stream.shutdown(Shutdown::Both);
            }
            Partner::Datagrams { closed } => closed.store(true, Relaxed),
        }
    }
}

/// Waits while this is so, no longer than the timeout.
fn wait_while(timeout: Duration, mut is_so: impl FnMut() -> bool) {
    let until = now() + timeout;
    while now() < until && is_so() {
        sleep_until(now() + Duration::from_millis(5));
    }
}

/// A queue, and the thread that writes its messages until the queue is closed or the law stops reading.
fn queue(mut write: impl FnMut(&[u8]) -> io::Result<()> + Send + 'static) -> (SyncSender<Vec<u8>>, JoinHandle<()>) {
    let (outbox, messages) = sync_channel::<Vec<u8>>(QUEUE);
    (outbox, thread::spawn(move || drop(messages.into_iter().try_for_each(|message| write(&message)))))
}

/// Passes on one line after another.
fn read_lines(from: impl Read, mut sink: impl Sink) {
    let mut from = BufReader::new(from);
    let mut line = Vec::new();
    let mut is_too_long = false;
    loop {
        let some = match from.fill_buf() {
            Ok(some @ [_, ..]) => some,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            _ => break,
        };
        let end = some.iter().position(|&byte| byte == b'\n');
        let part = &some[..end.unwrap_or(some.len())];
        if line.len() + part.len() > MAX_LINE {
            is_too_long = true;
            line = Vec::new();
        } else if !is_too_long {
            line.extend_from_slice(part);
        }
        let taken = end.map_or(some.len(), |end| end + 1);
        from.consume(taken);
        if end.is_some() {
            let message = if is_too_long { LawInput::TooLong } else { LawInput::Data(std::mem::take(&mut line)) };
            is_too_long = false;
            if !sink(now(), message) {
                return;
            }
        }
    }
    sink(now(), LawInput::End);
}

fn read_datagrams(socket: &UdpSocket, closed: &AtomicBool, mut sink: impl Sink) {
    let mut datagram = [0; 2048];
    while !closed.load(Relaxed) {
        match socket.recv(&mut datagram) {
            Ok(length) => {
                if !sink(now(), LawInput::Data(datagram[..length].to_vec())) {
                    return;
                }
            }
            Err(error) => match error.kind() {
                io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted => {}
                // The law is not up yet.
                io::ErrorKind::ConnectionReset | io::ErrorKind::ConnectionRefused => sleep_until(now() + POLL_PERIOD),
                _ => break,
            },
        }
    }
    sink(now(), LawInput::End);
}

#[cfg(test)]
mod tests;
