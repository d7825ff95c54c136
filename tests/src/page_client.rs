//! A small client of the page's server: HTTP requests byte for byte, and the WebSocket.
#![expect(clippy::unwrap_used, reason = "what a test cannot do has failed")]
#![expect(clippy::disallowed_methods, reason = "real processes take real time")]

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::{Duration, Instant};

use serde_json::Value;

/// Longest time that a test waits for an answer.
const TIMEOUT: Duration = Duration::from_secs(60);

fn connect(address: SocketAddr) -> TcpStream {
    let stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    stream.set_write_timeout(Some(TIMEOUT)).unwrap();
    stream
}

/// Sends these lines as a request and returns everything that comes back.
///
/// # Errors
/// If the server breaks the connection.
///
/// # Panics
/// If no server listens at this address.
pub fn request(address: SocketAddr, lines: &str) -> io::Result<String> {
    let mut stream = connect(address);
    stream.write_all(format!("{lines}Connection: close\r\n\r\n").as_bytes())?;
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer)?;
    Ok(String::from_utf8_lossy(&answer).into_owned())
}

/// A page's WebSocket.
#[derive(Debug)]
pub struct Socket {
    stream: TcpStream,
    unread: Vec<u8>,
}

/// A message from the server.
#[derive(Debug)]
pub enum Received {
    /// A text, which is always JSON.
    Json(Value),
    /// The places of a large swarm.
    Bytes,
    /// The server has closed the connection.
    Closed,
}

impl Socket {
    /// Opens the WebSocket with these further headers.
    ///
    /// # Errors
    /// The head of the answer if the server refuses, or that it has closed the connection.
    ///
    /// # Panics
    /// If no server listens at this address.
    pub fn open_with(address: SocketAddr, headers: &str) -> Result<Self, String> {
        let mut stream = connect(address);
        let request = format!(
            "GET /live HTTP/1.1\r\nHost: {address}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n\
             Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n{headers}\r\n"
        );
        stream.write_all(request.as_bytes()).map_err(|error| format!("closed: {error}"))?;
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            match stream.read(&mut byte) {
                Ok(1) => head.push(byte[0]),
                other => return Err(format!("closed: {other:?}")),
            }
        }
        let head = String::from_utf8(head).unwrap();
        match head.starts_with("HTTP/1.1 101 ") {
            true => Ok(Self { stream, unread: Vec::new() }),
            false => Err(head),
        }
    }

    /// Opens the WebSocket as the server's own page does.
    ///
    /// # Panics
    /// If the server refuses.
    pub fn open(address: SocketAddr) -> Self {
        Self::open_with(address, &format!("Origin: http://{address}\r\n")).unwrap()
    }

    /// Sends a text.
    pub fn send(&mut self, text: &str) {
        let mask = [7_u8, 1, 250, 99];
        let mut frame = vec![0x81];
        match u16::try_from(text.len()) {
            Ok(short) if short < 126 => frame.push(0x80 | short as u8),
            Ok(length) => {
                frame.push(0x80 | 126);
                frame.extend(length.to_be_bytes());
            }
            Err(_) => {
                frame.push(0x80 | 127);
                frame.extend((text.len() as u64).to_be_bytes());
            }
        }
        frame.extend(mask);
        frame.extend(text.bytes().zip(mask.iter().cycle()).map(|(byte, mask)| byte ^ mask));
        self.send_bytes(&frame);
    }

    /// Sends bytes that are a frame, or a part of one.
    pub fn send_bytes(&mut self, bytes: &[u8]) {
        // The server may have closed the connection.
        let _ = self.stream.write_all(bytes);
    }

    fn take(&mut self, count: usize) -> Option<Vec<u8>> {
        while self.unread.len() < count {
            let mut buffer = [0; 65536];
            match self.stream.read(&mut buffer) {
                Ok(0) => return None,
                Ok(read) => self.unread.extend(&buffer[..read]),
                Err(error) if error.kind() == ErrorKind::ConnectionReset => return None,
                Err(error) => panic!("nothing received: {error}"),
            }
        }
        let rest = self.unread.split_off(count);
        Some(std::mem::replace(&mut self.unread, rest))
    }

    /// Waits for the next message.
    ///
    /// # Panics
    /// If nothing is received for a minute.
    pub fn receive(&mut self) -> Received {
        loop {
            let Some(head) = self.take(2) else { return Received::Closed };
            let length = match head[1] & 0x7f {
                126 => u64::from(u16::from_be_bytes(self.take(2).unwrap().try_into().unwrap())),
                127 => u64::from_be_bytes(self.take(8).unwrap().try_into().unwrap()),
                short => short.into(),
            };
            let Some(payload) = self.take(length as usize) else { return Received::Closed };
            match head[0] & 0x0f {
                1 => return Received::Json(serde_json::from_slice(&payload).unwrap()),
                2 => return Received::Bytes,
                8 => return Received::Closed,
                _ => {}
            }
        }
    }

    /// Waits for a JSON message that fits.
    ///
    /// # Panics
    /// If none is received within a minute.
    pub fn wait_for(&mut self, what: &str, fits: impl Fn(&Value) -> bool) -> Value {
        let until = Instant::now() + TIMEOUT;
        loop {
            match self.receive() {
                Received::Json(message) if fits(&message) => return message,
                Received::Closed => panic!("closed while waiting for {what}"),
                _ => assert!(Instant::now() < until, "no {what}"),
            }
        }
    }

    /// Waits for the next snapshot.
    ///
    /// # Panics
    /// If none is received within a minute.
    pub fn snapshot(&mut self) -> Value {
        self.wait_for("snapshot", |message| message["type"] == "snapshot")
    }
}
