//! Hostile clients of the page's server: pages of other servers, a foreign name for this server, oversized messages, orders without
//! permission, clients that take nothing in, and two hundred connections.
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

use std::net::{SocketAddr, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use crate::page_client::{Received, Socket, request};

/// Number of connections that are open at the same time.
const CONNECTIONS: usize = 200;
/// Number of clients that take nothing in.
const SLOW: usize = 10;
/// How long the connections stay open.
const HELD: Duration = Duration::from_millis(500);
/// How long the answer to an order is waited for.
const ANSWERED: Duration = Duration::from_secs(5);

/// How often something was tried, and how often the server refused it.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    /// Number of attempts.
    pub tried: u32,
    /// Number of attempts that the server refused, or answered by closing the connection.
    pub refused: u32,
}

impl Tally {
    fn count(&mut self, is_refused: bool) {
        self.tried += 1;
        self.refused += u32::from(is_refused);
    }
}

/// What the server answered.
#[derive(Clone, Copy, Debug, Default)]
pub struct Answers {
    /// WebSockets of pages of other servers.
    pub foreign_pages: Tally,
    /// Requests under a foreign name that resolves to this PC (DNS rebinding).
    pub foreign_names: Tally,
    /// Messages that are larger than a page's may be, or claim to be.
    pub oversized: Tally,
    /// Orders without a token.
    pub orders: Tally,
}

impl Answers {
    /// All attempts by name.
    pub fn all(&self) -> [(&'static str, Tally); 4] {
        [
            ("pages of other servers", self.foreign_pages),
            ("foreign names", self.foreign_names),
            ("oversized messages", self.oversized),
            ("orders without a token", self.orders),
        ]
    }

    fn collect(&mut self, address: SocketAddr) {
        let foreign = Socket::open_with(address, "Origin: http://attacker.example\r\n");
        self.foreign_pages.count(foreign.is_err());
        let rebound = request(address, "GET / HTTP/1.1\r\nHost: attacker.example\r\n");
        self.foreign_names.count(!rebound.is_ok_and(|answer| answer.starts_with("HTTP/1.1 200 ")));
        // A whole message of a megabyte, and the head of one of 2^62 bytes.
        let whole = |page: &mut Socket| page.send(&" ".repeat(1 << 20));
        let head = |page: &mut Socket| page.send_bytes(&[0x81, 0xff, 0x40, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        let ways: [&dyn Fn(&mut Socket); 2] = [&whole, &head];
        for send in ways {
            if let Ok(mut page) = Socket::open_with(address, "") {
                send(&mut page);
                self.oversized.count(is_closed(&mut page));
            }
        }
        if let Ok(mut page) = Socket::open_with(address, "") {
            page.send(r#"{"type":"order","verb":"abort","vehicles":null,"teams":null}"#);
            self.orders.count(is_refused(&mut page));
        }
    }
}

/// Whether the server closes this connection.
fn is_closed(page: &mut Socket) -> bool {
    let until = Instant::now() + ANSWERED;
    while Instant::now() < until {
        if matches!(page.receive(), Received::Closed) {
            return true;
        }
    }
    false
}

/// Whether the server refuses the order that was sent on this connection.
fn is_refused(page: &mut Socket) -> bool {
    let until = Instant::now() + ANSWERED;
    while Instant::now() < until {
        match page.receive() {
            Received::Closed => return true,
            Received::Json(message) if message["type"] == "ordered" => return message["ok"] == false,
            Received::Json(_) | Received::Bytes => {}
        }
    }
    false
}

/// Hostile clients on a thread of their own.
#[derive(Debug)]
pub struct HostileClients {
    is_over: Arc<AtomicBool>,
    thread: JoinHandle<Answers>,
}

impl HostileClients {
    /// Begins to attack the server at this address.
    pub fn begin(address: SocketAddr) -> Self {
        let is_over = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&is_over);
        let thread = thread::spawn(move || {
            let mut answers = Answers::default();
            let slow: Vec<_> = (0..SLOW).filter_map(|_| Socket::open_with(address, "").ok()).collect();
            while !ends.load(Relaxed) {
                answers.collect(address);
                let held: Vec<_> = (0..CONNECTIONS).filter_map(|_| TcpStream::connect(address).ok()).collect();
                thread::sleep(HELD);
                drop(held);
            }
            drop(slow);
            answers
        });
        Self { is_over, thread }
    }

    /// Ends the attack and returns what the server answered.
    ///
    /// # Panics
    /// If a client met what no server may do.
    pub fn end(self) -> Answers {
        self.is_over.store(true, Relaxed);
        self.thread.join().expect("hostile clients that end")
    }
}
