//! A program that ran to its end.

use std::io::Read;
use std::process::{Command, Stdio};
use std::thread::{self, sleep};
use std::time::{Duration, Instant};

/// What became of a program.
#[derive(Clone, Debug)]
pub(super) struct Ran {
    /// Its exit status; `None` if a signal ended it.
    pub(super) status: Option<i32>,
    pub(super) out: String,
    pub(super) err: String,
    pub(super) took: Duration,
    line: String,
}

impl Ran {
    /// Runs it. One that takes longer than `within` has failed.
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
        // What it has left running may hold its output: that is nobody's business once it has ended.
        let ran = Self { status: status.code(), out: out.taken(), err: err.taken(), took, line };
        assert!(!is_late, "not done within {within:?}: {ran}");
        ran
    }

    /// It, if it ended well.
    #[track_caller]
    pub(super) fn good(self) -> Self {
        assert_eq!(self.status, Some(0), "{self}");
        self
    }

    /// The JSON that it printed.
    #[track_caller]
    pub(super) fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.out).unwrap_or_else(|error| panic!("no JSON ({error}): {self}"))
    }

    pub(super) fn took_s(&self) -> f64 {
        self.took.as_secs_f64()
    }
}

impl std::fmt::Display for Ran {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { status, out, err, took, line } = self;
        write!(f, "{line}\nexit status {status:?} after {:.2} s\n{out}\n{err}", took.as_secs_f64())
    }
}

/// What a thread reads until its end.
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
