//! The commands that are held down, each by a connection and until a time.

use std::collections::BTreeMap;

use tokio::time::Instant;

/// Commands that are held down. A connection is a number; 0 are the requests without a WebSocket.
#[derive(Debug, Default)]
pub(super) struct Active {
    held: BTreeMap<(u64, usize), Option<Instant>>,
    connections: u64,
}

impl Active {
    /// Number of a new connection.
    pub(super) fn connect(&mut self) -> u64 {
        self.connections += 1;
        self.connections
    }

    /// Holds a command down until then, or until it is released; returns whether nothing held it before.
    pub(super) fn hold(&mut self, connection: u64, command: usize, until: Option<Instant>) -> bool {
        let was_held = self.is_held(command);
        self.held.insert((connection, command), until);
        !was_held
    }

    /// Releases a command.
    pub(super) fn release(&mut self, connection: u64, command: usize) {
        self.held.remove(&(connection, command));
    }

    /// Releases all commands of a connection that has ended.
    pub(super) fn disconnect(&mut self, connection: u64) {
        self.held.retain(|(holder, _), _| *holder != connection);
    }

    /// Whether anything holds the command down.
    pub(super) fn is_held(&mut self, command: usize) -> bool {
        let now = Instant::now();
        self.held.retain(|_, until| until.is_none_or(|until| until > now));
        self.held.keys().any(|(_, held)| *held == command)
    }
}
