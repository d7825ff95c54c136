use super::*;

const FRAME_S: f64 = 0.02;

/// The peers stage of vehicle 1, and the heartbeats that vehicle 2 sends.
struct Watched {
    table: PeersStage,
    now_s: f64,
    sent: u64,
}

/// What vehicle 1 receives of vehicle 2.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Heartbeats {
    /// Ten a second.
    All,
    /// Five a second: every other one is lost.
    EveryOther,
    None,
}

impl Watched {
    /// A swarm that has flown for twenty seconds.
    fn steady() -> Self {
        let mut watched = Self { table: PeersStage::new(), now_s: 1.0, sent: 0 };
        assert_eq!(watched.pass(20.0, Heartbeats::All).len(), 1, "found");
        watched
    }

    /// Steps every frame. Returns the changes and their times, s.
    fn pass(&mut self, for_s: f64, heartbeats: Heartbeats) -> Vec<(Change, f64)> {
        let mut changes = Vec::new();
        for frame in 0..(for_s / FRAME_S).round() as u64 {
            self.now_s += FRAME_S;
            let is_sent = frame % 5 == 0;
            self.sent += u64::from(is_sent);
            let is_received = is_sent
                && match heartbeats {
                    Heartbeats::All => true,
                    Heartbeats::EveryOther => self.sent.is_multiple_of(2),
                    Heartbeats::None => false,
                };
            let heartbeat = is_received.then(|| mission(2, 1, self.sent, Membership::Active));
            let after_s = (frame + 1) as f64 * FRAME_S;
            let changed = self.table.receive(self.now_s, heartbeat.as_slice());
            changes.extend(changed.into_iter().map(|change| (change, after_s)));
        }
        changes
    }

    /// Asserts that vehicle 2 is lost after this time of silence, s.
    #[track_caller]
    fn assert_lost_after(&mut self, limit_s: f64) {
        let changes = self.pass(limit_s + 2.0, Heartbeats::None);
        let [(Change::Lost(lost), after_s)] = changes[..] else { panic!("{changes:?}") };
        // The last heartbeat came up to four frames before.
        assert!(lost == id(2) && (limit_s - 0.1..limit_s + 0.05).contains(&after_s), "lost after {after_s} s");
    }
}

#[test]
fn a_peer_whose_link_loses_nothing_is_lost_after_a_second_and_back_with_its_next_message() {
    let mut watched = Watched::steady();
    watched.assert_lost_after(1.0);
    let [(Change::Found(_), after_s)] = watched.pass(0.5, Heartbeats::All)[..] else { panic!("not found again") };
    assert!(after_s < 0.03, "{after_s} s");
}

#[test]
fn a_peer_that_has_just_been_found_may_be_silent_for_twice_as_long() {
    let mut watched = Watched { table: PeersStage::new(), now_s: 1.0, sent: 0 };
    watched.pass(5.0, Heartbeats::All);
    watched.assert_lost_after(2.0);
}

#[test]
fn a_peer_whose_heartbeats_are_lost_may_be_silent_for_twice_as_long() {
    let mut watched = Watched::steady();
    assert_eq!(watched.pass(5.0, Heartbeats::EveryOther), []);
    watched.assert_lost_after(2.0);
}

#[test]
fn the_time_since_the_last_lost_heartbeat_is_over_in_the_middle_of_a_silence() {
    let mut watched = Watched::steady();
    watched.pass(0.6, Heartbeats::EveryOther);
    watched.pass(8.6, Heartbeats::All);
    let silent = watched.pass(3.0, Heartbeats::None);
    let [(Change::Lost(_), after_s)] = silent[..] else { panic!("{silent:?}") };
    assert!((1.0..1.5).contains(&after_s), "{after_s} s");
}

#[test]
fn a_suspicion_that_came_too_early_lengthens_the_silence_until_overload_has_passed() {
    let mut watched = Watched::steady();
    assert_eq!(watched.pass(1.5, Heartbeats::None).len(), 1, "suspected");
    watched.pass(0.5, Heartbeats::All);
    watched.assert_lost_after(2.0);
    let mut watched = Watched::steady();
    assert_eq!(watched.pass(1.5, Heartbeats::None).len(), 1, "suspected");
    watched.pass(12.0, Heartbeats::All);
    watched.assert_lost_after(1.0);
}

#[test]
fn a_vehicle_that_was_away_for_long_was_not_suspected_too_early() {
    let mut watched = Watched::steady();
    assert_eq!(watched.pass(5.0, Heartbeats::None).len(), 1, "suspected");
    watched.pass(11.0, Heartbeats::All);
    watched.assert_lost_after(1.0);
}

#[test]
fn no_peer_is_suspected_while_the_own_agent_is_late() {
    let mut watched = Watched::steady();
    for _ in 0..100 {
        watched.now_s += 0.3;
        watched.table.0.did_not_run(0.3);
        assert_eq!(watched.table.receive(watched.now_s, &[]), [], "time in which it did not run is not counted");
    }
    watched.assert_lost_after(4.0);
}

#[test]
fn a_suspected_peer_whose_last_message_comes_with_the_end_of_its_link_stays_lost() {
    let mut watched = Watched::steady();
    assert_eq!(watched.pass(1.5, Heartbeats::None).len(), 1, "suspected");
    let last = mission(2, 1, watched.sent + 1, Membership::Active);
    assert_eq!(watched.table.receive(watched.now_s + FRAME_S, &[last, PeerMessage::Vanished(id(2))]), []);
    assert!(watched.table.0.in_contact().is_empty());
}
