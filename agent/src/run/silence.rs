//! Detects silent peers by the age of their last message, not by Zenoh's lease.
//!
//! Agents send ten messages a second over reliable links, so one second without any means that a peer hangs or is cut
//! off. When this computer is the slow one, a peer must not be suspected: time in which the own control thread did not
//! run is not counted, and each sign of overload doubles the timeout, up to the time after which Zenoh itself ends the
//! link. A peer that has just appeared gets that longest timeout too, because a whole swarm is starting then.

use std::collections::BTreeMap;

use skein_common::id::VehicleId;
use skein_common::time::LocalTime;

use skein_core::peers::{PeerMessage, Received};

/// Timeout on a computer that keeps up, s.
const TIMEOUT_S: f64 = 1.0;
/// Longest timeout: while the swarm starts, or while this computer is overloaded, s.
const MAX_TIMEOUT_S: f64 = 4.0;
/// After a peer has appeared, the longest timeout applies for this time, s.
const START_GRACE_S: f64 = 10.0;
/// The control thread checks every frame. A check that comes later than this after the previous one is late, s.
const LATE_S: f64 = 0.1;
/// After this time without a sign of overload the timeout is halved, s.
const CALM_S: f64 = 10.0;

/// Watches the peers for silence.
#[derive(Debug)]
pub(super) struct SilenceMonitor {
    peers: BTreeMap<VehicleId, WatchedPeer>,
    timeout_s: f64,
    last_check: Option<LocalTime>,
    /// When overload was last detected, or the timeout last halved.
    calm_since: LocalTime,
}

#[derive(Debug)]
struct WatchedPeer {
    /// When its first message arrived, or the first one after its link was lost.
    appeared: LocalTime,
    /// Time without a message, counted only while this computer kept up, s.
    silent_s: f64,
    is_suspected: bool,
    /// When it has sent again after a suspicion, in this check.
    returned: Option<LocalTime>,
}

impl SilenceMonitor {
    pub(super) fn new() -> Self {
        Self { peers: BTreeMap::new(), timeout_s: TIMEOUT_S, last_check: None, calm_since: LocalTime::ZERO }
    }

    /// Appends to `arrived` a `Vanished` for each peer that has become silent and an `Appeared` for each that sends
    /// again. Returns how long the own control thread did not run, s, if this check is late.
    pub(super) fn watch(&mut self, now: LocalTime, arrived: &mut Vec<Received>) -> Option<f64> {
        let since_s = self.last_check.map_or(0.0, |last_check| now.seconds_since(last_check));
        self.last_check = Some(now);
        let is_late = since_s > LATE_S;
        if is_late {
            self.back_off(now);
        }
        for peer in self.peers.values_mut().filter(|_| !is_late) {
            peer.silent_s += since_s;
        }
        for &Received { message, at } in &*arrived {
            match message {
                PeerMessage::State(_) | PeerMessage::Mission(_) => {
                    let Some(id) = message.sender() else { continue };
                    let new = WatchedPeer { appeared: at, silent_s: 0.0, is_suspected: false, returned: None };
                    let peer = self.peers.entry(id).or_insert(new);
                    peer.silent_s = 0.0;
                    if std::mem::replace(&mut peer.is_suspected, false) {
                        peer.returned = Some(at);
                        // It was suspected too early.
                        self.back_off(now);
                    }
                }
                // The link reports this peer's state, also if its last message came just before the link ended.
                PeerMessage::Vanished(id) | PeerMessage::Appeared(id) => drop(self.peers.remove(&id)),
                PeerMessage::Order(_) => {}
            }
        }
        for (&id, peer) in &mut self.peers {
            if let Some(at) = peer.returned.take() {
                arrived.push(Received { message: PeerMessage::Appeared(id), at });
            }
            let is_starting = now.seconds_since(peer.appeared) < START_GRACE_S;
            let timeout_s = if is_starting { MAX_TIMEOUT_S } else { self.timeout_s };
            if !peer.is_suspected && peer.silent_s > timeout_s {
                peer.is_suspected = true;
                arrived.push(Received { message: PeerMessage::Vanished(id), at: now });
            }
        }
        if now.seconds_since(self.calm_since) > CALM_S {
            self.timeout_s = (self.timeout_s / 2.0).max(TIMEOUT_S);
            self.calm_since = now;
        }
        is_late.then_some(since_s)
    }

    fn back_off(&mut self, now: LocalTime) {
        self.timeout_s = (self.timeout_s * 2.0).min(MAX_TIMEOUT_S);
        self.calm_since = now;
    }
}

#[cfg(test)]
mod tests {
    use skein_common::id::{Incarnation, VehicleSet};
    use skein_common::message::{Header, Heartbeat};
    use skein_common::time::SenderStamp;

    use super::*;

    const FRAME_S: f64 = 0.02;

    fn id(number: u8) -> VehicleId {
        VehicleId::new(number).unwrap()
    }

    fn heartbeat(sender: u8) -> PeerMessage {
        let header = Header { sender: id(sender), incarnation: Incarnation(1), sequence: 1, stamp: SenderStamp::ZERO };
        PeerMessage::Mission(Heartbeat {
            header,
            plan: 7,
            membership: Default::default(),
            step: 0,
            vouched: 0,
            reached: None,
            progress_m: 0.0,
            order: None,
            orders: 0,
            echo: None,
            lost: VehicleSet::default(),
        })
    }

    struct Watched {
        silence: SilenceMonitor,
        now_s: f64,
    }

    impl Watched {
        /// A swarm that has started: messages of vehicle 2 arrived for twenty seconds.
        fn steady() -> Self {
            let mut watched = Self { silence: SilenceMonitor::new(), now_s: 0.0 };
            assert_eq!(watched.pass(20.0, FRAME_S, &[2]), []);
            watched
        }

        /// Checks every `every_s`; a heartbeat of each of `received` arrives every time. Returns the appended messages and
        /// their times, s.
        fn pass(&mut self, for_s: f64, every_s: f64, received: &[u8]) -> Vec<(PeerMessage, f64)> {
            let begin_s = self.now_s;
            let mut added = Vec::new();
            while self.now_s < begin_s + for_s - 1e-9 {
                self.now_s += every_s;
                let at = LocalTime::from_seconds(self.now_s);
                let mut arrived: Vec<_> =
                    received.iter().map(|&sender| Received { message: heartbeat(sender), at }).collect();
                self.silence.watch(at, &mut arrived);
                added.extend(
                    arrived.split_off(received.len()).iter().map(|received| (received.message, self.now_s - begin_s)),
                );
            }
            added
        }
    }

    #[test]
    fn a_peer_silent_for_a_second_is_suspected_once_and_restored_by_its_next_message() {
        let mut watched = Watched::steady();
        let [(message, after_s)] = watched.pass(3.0, FRAME_S, &[])[..] else { panic!("not suspected exactly once") };
        assert!(
            message == PeerMessage::Vanished(id(2)) && (0.99..1.05).contains(&after_s),
            "{message:?} after {after_s} s"
        );
        let [(message, after_s)] = watched.pass(0.5, FRAME_S, &[2])[..] else { panic!("not restored exactly once") };
        assert!(message == PeerMessage::Appeared(id(2)) && after_s < 0.03, "{message:?} after {after_s} s");
    }

    #[test]
    fn a_suspected_peer_whose_last_message_comes_with_the_end_of_its_link_is_gone() {
        let mut watched = Watched::steady();
        assert_eq!(watched.pass(2.0, FRAME_S, &[]).len(), 1, "suspected");
        let at = LocalTime::from_seconds(watched.now_s + FRAME_S);
        let mut arrived = [heartbeat(2), PeerMessage::Vanished(id(2))].map(|message| Received { message, at }).to_vec();
        watched.silence.watch(at, &mut arrived);
        assert_eq!(arrived.len(), 2, "{arrived:?}");
    }

    #[test]
    fn a_false_suspicion_lengthens_the_timeout_until_overload_has_passed() {
        let mut watched = Watched::steady();
        watched.pass(1.5, FRAME_S, &[]);
        watched.pass(1.0, FRAME_S, &[2]);
        assert_eq!(watched.pass(1.9, FRAME_S, &[]), [], "the timeout is two seconds now");
        watched.pass(21.0, FRAME_S, &[2]);
        assert_eq!(watched.pass(1.1, FRAME_S, &[]).len(), 1);
    }

    #[test]
    fn no_peer_is_suspected_while_the_own_control_thread_is_late() {
        let mut watched = Watched::steady();
        assert_eq!(watched.pass(30.0, 0.3, &[]), [], "time without checks is not counted");
        assert_eq!(watched.pass(3.9, FRAME_S, &[]), [], "the timeout stays longer for a while");
        assert_eq!(watched.pass(0.3, FRAME_S, &[]).len(), 1, "a peer that stays silent is suspected at last");
    }

    #[test]
    fn a_pc_that_resumes_after_ten_minutes_suspects_no_peer_for_that_time() {
        let mut watched = Watched::steady();
        watched.now_s += 600.0;
        let late_s = watched.silence.watch(LocalTime::from_seconds(watched.now_s), &mut Vec::new());
        assert!(late_s.is_some_and(|late_s| (late_s - 600.0).abs() < 1e-6), "the agent learns of it: {late_s:?}");
        assert_eq!(watched.pass(1.9, FRAME_S, &[]), [], "its links come back meanwhile");
        assert_eq!(watched.pass(20.0, FRAME_S, &[2]), []);
        let [(message, _)] = watched.pass(2.1, FRAME_S, &[])[..] else { panic!("not exactly one suspected") };
        assert_eq!(message, PeerMessage::Vanished(id(2)), "a peer that is then silent is suspected as before");
    }

    #[test]
    fn a_starting_swarm_gets_the_longest_timeout() {
        let mut watched = Watched { silence: SilenceMonitor::new(), now_s: 0.0 };
        watched.pass(0.1, FRAME_S, &[2, 3]);
        assert_eq!(watched.pass(3.8, FRAME_S, &[3]), []);
        let [(message, _)] = watched.pass(0.4, FRAME_S, &[3])[..] else { panic!("not exactly one suspected") };
        assert_eq!(message, PeerMessage::Vanished(id(2)));
        let at = LocalTime::from_seconds(watched.now_s);
        watched.silence.watch(at, &mut vec![Received { message: PeerMessage::Vanished(id(3)), at }]);
        assert_eq!(watched.pass(10.0, FRAME_S, &[]), [], "the link reports a peer whose link was lost");
    }
}
