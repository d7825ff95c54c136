//! A program that has ended, with its output.

use std::io::Read;
use std::process::{Command, Stdio};
use std::thread::{self, sleep};
use std::time::{Duration, Instant};

/// Result of a program.
#[derive(Clone, Debug)]
pub(super) struct Finished {
    /// Exit status; `None` if a signal ended the program.
    pub(super) status: Option<i32>,
    pub(super) out: String,
    pub(super) err: String,
    pub(super) took: Duration,
    line: String,
}

impl Finished {
    /// Runs a program. The test fails if it takes longer than `within`.
    pub(super) fn of(command: &mut Command, within: Duration) -> Self {
        let line = format!("{command:?}");
        let began = Instant::now();
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let out = read(child.stdout.take().unwrap());
        let err = read(child.stderr.take().unwrap());
        let mut is_late = false;
        let status = loop {
            if let Some(status) = child.try_wait().unwrap() {
                break status;
            }
            if !is_late && began.elapsed() > within {
                is_late = true;
                let _ = child.kill();
            }
            sleep(Duration::from_millis(2));
        };
        let took = began.elapsed();
        // Processes that it left running may keep its output open: the test does not wait for them.
        let finished = Self { status: status.code(), out: out.taken(), err: err.taken(), took, line };
        assert!(!is_late, "not done within {within:?}: {finished}");
        finished
    }

    /// The result, after a check that the exit status is 0.
    #[track_caller]
    pub(super) fn succeeded(self) -> Self {
        assert_eq!(self.status, Some(0), "{self}");
        self
    }

    /// The JSON that the program printed.
    #[track_caller]
    pub(super) fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.out).unwrap_or_else(|error| panic!("no JSON ({error}): {self}"))
    }

    pub(super) fn took_s(&self) -> f64 {
        self.took.as_secs_f64()
    }
}

impl std::fmt::Display for Finished {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { status, out, err, took, line } = self;
        write!(f, "{line}\nexit status {status:?} after {:.2} s\n{out}\n{err}", took.as_secs_f64())
    }
}

/// Output that a thread reads to its end.
struct Reading {
    text: std::sync::Arc<std::sync::Mutex<Vec<u8>>>,
    done: std::sync::mpsc::Receiver<()>,
}

impl Reading {
    fn taken(self) -> String {
        let _ = self.done.recv_timeout(Duration::from_millis(500));
        String::from_utf8_lossy(&self.text.lock().unwrap()).into_owned()
    }
}

fn read(mut from: impl Read + Send + 'static) -> Reading {
    let text = std::sync::Arc::new(std::sync::Mutex::new(Vec::new()));
    let (end, done) = std::sync::mpsc::channel();
    let into = text.clone();
    thread::spawn(move || {
        let mut buffer = [0; 4096];
        while let Ok(count @ 1..) = from.read(&mut buffer) {
            into.lock().unwrap().extend_from_slice(&buffer[..count]);
        }
        let _ = end.send(());
    });
    Reading { text, done }
}
