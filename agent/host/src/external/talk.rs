//! One conversation with a law: over the standard streams of a process, a TCP connection, or a UDP socket.
//!
//! What is said waits in a short queue for a thread that may block, what is heard is handed on by another: whoever holds
//! a [`Talk`] never waits for the law, and a law that says too much waits for whoever listens. Of a line that does not end
//! no more than [`MAX_LINE`] bytes are kept.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpStream, ToSocketAddrs, UdpSocket};
use std::process::{Child, ChildStderr, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use super::protocol::{MAX_LINE, Said};
use super::vector;
use crate::clock::{now, sleep_until};
use crate::process::in_own_group;

/// Words that wait to be said: a law that takes up no more is not asked more.
const QUEUE: usize = 1024;
/// A process that was told bye gets this long, then it is ended.
const END_WITHIN: Duration = Duration::from_secs(1);
/// A connection over which nothing goes out for this long is dead.
const WRITE_WITHIN: Duration = Duration::from_secs(1);
/// How often a thread that listens for datagrams looks whether it is still wanted.
const LOOK_UP: Duration = Duration::from_millis(100);

/// Something heard of a law.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Word {
    /// A line without its end, or a datagram.
    Said(Vec<u8>),
    /// A line that was too long.
    TooLong,
    /// Nothing more will come.
    End,
}

/// Takes what is heard, and when; false when nobody wants any more of it.
pub trait Sink: FnMut(Instant, Word) -> bool + Send + 'static {}
impl<F: FnMut(Instant, Word) -> bool + Send + 'static> Sink for F {}

/// A conversation. When it is dropped the law is told bye, and a process is waited for and ended.
#[derive(Debug)]
pub struct Talk {
    outbox: Option<SyncSender<Vec<u8>>>,
    writer: Option<JoinHandle<()>>,
    partner: Partner,
}

#[derive(Debug)]
enum Partner {
    Process(Child),
    Connection(TcpStream),
    Datagrams { closed: Arc<AtomicBool> },
}

/// Nobody takes up what is said.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Deaf;

impl Talk {
    /// Starts a process. Each line that it writes to its standard error goes to `tell`. A process in its `own_group` does
    /// not hear the terminal's Ctrl-C.
    ///
    /// # Errors
    /// If it does not start.
    pub fn process(
        command: &[String],
        own_group: bool,
        sink: impl Sink,
        tell: impl Fn(&str) + Send + 'static,
    ) -> io::Result<Self> {
        let (program, arguments) = command.split_first().ok_or(io::ErrorKind::NotFound)?;
        let mut command = Command::new(program);
        command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        if own_group {
            in_own_group(&mut command);
        }
        let mut process = command.spawn()?;
        if let Some(stderr) = process.stderr.take() {
            thread::spawn(move || pass_on(stderr, tell));
        }
        if let Some(stdout) = process.stdout.take() {
            thread::spawn(move || read_lines(stdout, sink));
        }
        let (outbox, words) = sync_channel(QUEUE);
        let stdin = process.stdin.take();
        let writer = stdin.map(|stdin| thread::spawn(move || write_all(words, stdin)));
        Ok(Self { outbox: Some(outbox), writer, partner: Partner::Process(process) })
    }

    /// Over a connection that a law has made.
    ///
    /// # Errors
    /// If the system gives no second handle to it.
    pub fn connection(stream: TcpStream, sink: impl Sink) -> io::Result<Self> {
        stream.set_nonblocking(false)?;
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(WRITE_WITHIN))?;
        let (reading, writing) = (stream.try_clone()?, stream.try_clone()?);
        thread::spawn(move || read_lines(reading, sink));
        let (outbox, words) = sync_channel(QUEUE);
        let writer = thread::spawn(move || write_all(words, writing));
        Ok(Self { outbox: Some(outbox), writer: Some(writer), partner: Partner::Connection(stream) })
    }

    /// Over datagrams: what is said goes to `ask`, what comes to `answer` is heard, whoever sends it.
    ///
    /// # Errors
    /// If an address is none, or the port cannot be had.
    pub fn datagrams(ask: (&str, u16), answer: (&str, u16), sink: impl Sink) -> io::Result<Self> {
        let socket = UdpSocket::bind(answer)?;
        socket.set_read_timeout(Some(LOOK_UP))?;
        let of_kind = |address: &SocketAddr| socket.local_addr().is_ok_and(|own| own.is_ipv4() == address.is_ipv4());
        let to = ask.to_socket_addrs()?.find(of_kind).ok_or(io::ErrorKind::AddrNotAvailable)?;
        let (reading, closed) = (socket.try_clone()?, Arc::new(AtomicBool::new(false)));
        let of_reader = closed.clone();
        thread::spawn(move || read_datagrams(&reading, &of_reader, sink));
        let (outbox, words) = sync_channel::<Vec<u8>>(QUEUE);
        let writer = thread::spawn(move || {
            for word in words {
                // Nobody there yet is no reason to end.
                let _ = socket.send_to(&word, to);
            }
        });
        Ok(Self { outbox: Some(outbox), writer: Some(writer), partner: Partner::Datagrams { closed } })
    }

    /// Says something, without waiting: a program of vectors hears only asks.
    ///
    /// # Errors
    /// If nobody takes it up.
    pub fn say(&self, said: &Said<'_>) -> Result<(), Deaf> {
        let word = match (&self.partner, said) {
            (Partner::Datagrams { .. }, Said::Ask(ask)) => vector::write(ask),
            (Partner::Datagrams { .. }, _) => return Ok(()),
            _ => said.line(),
        };
        match self.outbox.as_ref().map(|outbox| outbox.try_send(word)) {
            Some(Ok(())) => Ok(()),
            // It is behind; what it does not hear it does not answer.
            Some(Err(TrySendError::Full(_))) => Ok(()),
            Some(Err(TrySendError::Disconnected(_))) | None => Err(Deaf),
        }
    }

    /// Whether it is one of vectors.
    pub fn is_of_vectors(&self) -> bool {
        matches!(self.partner, Partner::Datagrams { .. })
    }

    /// How a process ended that has, in words.
    pub fn how_it_ended(&mut self) -> String {
        let Partner::Process(process) = &mut self.partner else { return "has closed the connection".to_owned() };
        let until = now() + END_WITHIN;
        loop {
            match process.try_wait() {
                Ok(Some(status)) => return format!("has ended ({status})"),
                Ok(None) if now() < until => sleep_until(now() + Duration::from_millis(5)),
                _ => return "has closed its input or its output".to_owned(),
            }
        }
    }

    /// Says bye and closes the law's input: the beginning of the end.
    pub fn say_bye(&mut self) {
        let _ = self.say(&Said::Bye);
        self.outbox = None;
    }
}

impl Drop for Talk {
    fn drop(&mut self) {
        self.say_bye();
        match &mut self.partner {
            Partner::Process(process) => {
                let until = now() + END_WITHIN;
                while now() < until && matches!(process.try_wait(), Ok(None)) {
                    sleep_until(now() + Duration::from_millis(5));
                }
                // What it has started itself may still hold its streams: the threads end with those.
                let _ = process.kill();
                let _ = process.wait();
            }
            Partner::Connection(stream) => {
                self.writer.take().map(JoinHandle::join);
                let _ = stream.shutdown(Shutdown::Both);
            }
            Partner::Datagrams { closed } => closed.store(true, Relaxed),
        }
    }
}

/// Says what comes until nothing more will, or nobody listens.
fn write_all(words: Receiver<Vec<u8>>, mut to: impl Write) {
    for word in words {
        if to.write_all(&word).and_then(|()| to.flush()).is_err() {
            return;
        }
    }
}

/// Hands on line after line.
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
            let word = if is_too_long { Word::TooLong } else { Word::Said(std::mem::take(&mut line)) };
            is_too_long = false;
            if !sink(now(), word) {
                return;
            }
        }
    }
    sink(now(), Word::End);
}

fn read_datagrams(socket: &UdpSocket, closed: &AtomicBool, mut sink: impl Sink) {
    let mut datagram = [0; 2048];
    while !closed.load(Relaxed) {
        match socket.recv(&mut datagram) {
            Ok(length) => {
                if !sink(now(), Word::Said(datagram[..length].to_vec())) {
                    return;
                }
            }
            Err(error) => match error.kind() {
                io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted => {}
                // Nobody there, yet.
                io::ErrorKind::ConnectionReset | io::ErrorKind::ConnectionRefused => sleep_until(now() + LOOK_UP),
                _ => break,
            },
        }
    }
    sink(now(), Word::End);
}

/// What a law writes to its standard error, line by line.
fn pass_on(stderr: ChildStderr, tell: impl Fn(&str) + Send + 'static) {
    read_lines(stderr, move |_, word| {
        if let Word::Said(line) = word {
            tell(String::from_utf8_lossy(&line).trim_end());
        }
        true
    });
}

#[cfg(test)]
mod tests;
