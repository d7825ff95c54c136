//! The clients and their subscriptions. Every table is bounded, because any program can subscribe.

use std::net::SocketAddr;

use super::datarefs::Handle;

/// Largest number of clients.
pub(super) const MAX_CLIENTS: usize = 64;
/// Largest number of clients at one IP address: one computer must not take all places.
pub(super) const MAX_CLIENTS_OF_ONE_HOST: usize = 48;
/// Largest number of values that one client subscribes to.
pub(super) const MAX_SUBSCRIPTIONS: usize = 1000;

/// Decides in which frames something is sent `rate_hz` times a second; the rate is exact on average.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Schedule {
    rate_hz: u32,
    /// Grows by the rate every frame; at the frame rate the thing is due.
    phase: u32,
}

impl Schedule {
    /// Due in the next frame and then at the rate, at most once a frame.
    pub(super) fn new(rate_hz: u32, frame_rate_hz: u32) -> Self {
        let rate_hz = rate_hz.min(frame_rate_hz);
        Self { rate_hz, phase: frame_rate_hz - rate_hz }
    }

    /// Changes the rate; the phase stays if it is the same.
    pub(super) fn set_rate(&mut self, rate_hz: u32, frame_rate_hz: u32) {
        let new = Self::new(rate_hz, frame_rate_hz);
        *self = if self.rate_hz == new.rate_hz { *self } else { new };
    }

    /// Advances by one frame; returns whether the thing is due in it.
    pub(super) fn is_due(&mut self, frame_rate_hz: u32) -> bool {
        self.phase += self.rate_hz;
        let is_due = self.phase >= frame_rate_hz;
        self.phase -= if is_due { frame_rate_hz } else { 0 };
        is_due
    }
}

/// A client's subscription to one dataref.
pub(super) struct Subscription {
    /// The client's own number for it.
    pub(super) index: i32,
    pub(super) handle: Handle,
    pub(super) schedule: Schedule,
}

/// A client, identified by its address and port.
pub(super) struct Subscriber {
    pub(super) address: SocketAddr,
    pub(super) position: Option<Schedule>,
    pub(super) values: Vec<Subscription>,
    /// Frame in which it last sent anything.
    pub(super) last_received: u64,
}

/// All clients.
pub(super) struct Clients {
    pub(super) all: Vec<Subscriber>,
    frame_rate_hz: u32,
    /// Number of frames after which a silent client may be replaced.
    silence: u64,
}

impl Clients {
    pub(super) fn new(frame_rate_hz: u32, silence: u64) -> Self {
        Self { all: Vec::new(), frame_rate_hz, silence }
    }

    /// Records that a client has sent a datagram.
    pub(super) fn received(&mut self, address: SocketAddr, frame: u64) {
        if let Some(client) = self.all.iter_mut().find(|client| client.address == address) {
            client.last_received = frame;
        }
    }

    pub(super) fn subscribe_position(&mut self, address: SocketAddr, rate_hz: u32, frame: u64) {
        let frame_rate_hz = self.frame_rate_hz;
        if rate_hz == 0 {
            self.change(address, |client| client.position = None);
        } else if let Some(client) = self.client(address, frame) {
            client.position.get_or_insert_default().set_rate(rate_hz, frame_rate_hz);
        }
    }

    /// Subscribes a client to a value. A request with the same index replaces the earlier one.
    pub(super) fn subscribe_value(
        &mut self,
        address: SocketAddr,
        index: i32,
        handle: Handle,
        rate_hz: u32,
        frame: u64,
    ) {
        let frame_rate_hz = self.frame_rate_hz;
        let Some(client) = self.client(address, frame) else { return };
        if let Some(value) = client.values.iter_mut().find(|value| value.index == index) {
            value.handle = handle;
            value.schedule.set_rate(rate_hz, frame_rate_hz);
        } else if client.values.len() < MAX_SUBSCRIPTIONS {
            client.values.push(Subscription { index, handle, schedule: Schedule::new(rate_hz, frame_rate_hz) });
        }
    }

    pub(super) fn unsubscribe_value(&mut self, address: SocketAddr, index: i32) {
        self.change(address, |client| client.values.retain(|value| value.index != index));
    }

    pub(super) fn forget(&mut self, address: SocketAddr) {
        self.all.retain(|client| client.address != address);
    }

    /// Changes a client, if it exists; a client without subscriptions is removed.
    fn change(&mut self, address: SocketAddr, change: impl FnOnce(&mut Subscriber)) {
        if let Some(client) = self.all.iter_mut().find(|client| client.address == address) {
            change(client);
        }
        self.all.retain(|client| client.position.is_some() || !client.values.is_empty());
    }

    /// The client with this address, a new one if needed. X-Plane keeps sending to clients that have gone, and so does
    /// this server; but when the table is full, a new client replaces one that has been silent for long.
    fn client(&mut self, address: SocketAddr, frame: u64) -> Option<&mut Subscriber> {
        if let Some(at) = self.all.iter().position(|client| client.address == address) {
            return self.all.get_mut(at);
        }
        let is_same_host = |client: &Subscriber| client.address.ip() == address.ip();
        let is_host_full = self.all.iter().filter(|client| is_same_host(client)).count() >= MAX_CLIENTS_OF_ONE_HOST;
        if is_host_full || self.all.len() >= MAX_CLIENTS {
            // A computer that has all of its places can replace only clients of its own.
            let replaceable = self.all.iter().enumerate().filter(|(_, client)| !is_host_full || is_same_host(client));
            let (at, _) = replaceable
                .min_by_key(|(_, client)| client.last_received)
                .filter(|(_, client)| client.last_received + self.silence < frame)?;
            self.all.swap_remove(at);
        }
        self.all.push(Subscriber { address, position: None, values: Vec::new(), last_received: frame });
        self.all.last_mut()
    }
}
