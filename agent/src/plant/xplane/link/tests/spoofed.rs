//! Another program on the same computer imitates X-Plane.

use super::live::{Live, options};
use super::*;

/// Position of the stand-in at rest, as known to the other program.
const STANDING: Position = Position {
    latitude_deg: 28.0,
    longitude_deg: -82.0,
    elevation_m: 0.242,
    height_m: 0.242,
    pitch_deg: 0.0,
    heading_deg: 0.0,
    roll_deg: 0.0,
    velocity_east_m_s: 0.0,
    velocity_up_m_s: 0.0,
    velocity_south_m_s: 0.0,
    roll_rate_rad_s: 0.0,
    pitch_rate_rad_s: 0.0,
    yaw_rate_rad_s: 0.0,
};
/// A spoofed position: it turns, which the stand-in does not.
const SPOOFED: Position = Position { yaw_rate_rad_s: 3.0, roll_deg: 40.0, ..STANDING };
const FAR: Position = Position { latitude_deg: 28.01, elevation_m: 80.0, height_m: 80.0, ..SPOOFED };

fn encoded(position: &Position) -> Vec<u8> {
    let mut datagram = Vec::new();
    position.encode(&mut datagram);
    datagram
}

/// Whether a frame was spoofed.
fn is_spoofed(frame: &Frame) -> bool {
    frame.measurement.rates.yaw_rad_s > 2.0
}

/// Runs `fly` while these positions are sent to the link a thousand times a second from another port.
fn under_attack<T>(link: &mut XPlane, positions: &[Position], fly: impl FnOnce(&mut XPlane) -> T) -> T {
    let to = link.port.socket.local_addr().unwrap();
    let datagrams: Vec<_> = positions.iter().map(encoded).collect();
    let stop = AtomicBool::new(false);
    thread::scope(|scope| {
        scopeguard::defer! { stop.store(true, Relaxed) }
        scope.spawn(|| {
            let socket = UdpSocket::bind((LOCAL, 0)).unwrap();
            while !stop.load(Relaxed) {
                for datagram in &datagrams {
                    let _ = socket.send_to(datagram, to);
                }
                sleep_until(now() + Duration::from_millis(1));
            }
        });
        fly(link)
    })
}

fn split() -> Live {
    Live::run(Standin::open(&StandinOptions { split_ports: true, ..options(0) }).unwrap())
}

#[test]
fn another_address_and_another_port_are_not_the_simulator() {
    let (simulator, mut link) = Scripted::silent();
    let to = link.port.socket.local_addr().unwrap();
    let other_port = UdpSocket::bind((LOCAL, 0)).unwrap();
    other_port.send_to(&encoded(&at_height(1.0)), to).unwrap();
    assert_eq!(link.wait(SOON).frame, None, "the simulator has sent nothing yet");
    assert_eq!(link.counters().unproven, 1);

    simulator.send_place(&link, &at_height(1.0));
    simulator.send_position(&link, at_height(2.0));
    other_port.send_to(&encoded(&at_height(3.0)), to).unwrap();
    assert_eq!(next_frame(&mut link).measurement.height_m, 2.0);
    assert_eq!((link.counters().foreign, link.drops().malformed), (1, 0));

    let Ok(stranger) = UdpSocket::bind((Ipv4Addr::new(127, 0, 0, 2), 0)) else {
        return println!("skipped: this computer has one loopback address only");
    };
    stranger.send_to(&encoded(&at_height(4.0)), to).unwrap();
    assert_eq!(link.wait(SOON).frame, None);
    assert_eq!((link.drops().foreign, link.drops().malformed), (2, 0));
}

#[test]
fn values_with_guessed_indices_are_dropped() {
    let (simulator, mut link) = Scripted::new();
    let to = link.port.socket.local_addr().unwrap();
    let spoofer = UdpSocket::bind((LOCAL, 0)).unwrap();
    let mut datagram = Vec::new();
    for first in 0..100 {
        let guesses: Vec<_> = (first * 183..(first + 1) * 183).map(|index| (index, 1.0)).collect();
        rref::encode_values(&guesses, &mut datagram).unwrap();
        spoofer.send_to(&datagram, to).unwrap();
        link.wait(Duration::ZERO);
    }
    // A flood of many hours may hit one index, but the sender does not learn which.
    let hit = [(simulator.index(PAUSED), 1.0), (7, 1.0)];
    rref::encode_values(&hit, &mut datagram).unwrap();
    spoofer.send_to(&datagram, to).unwrap();
    assert_eq!(link.wait(SOON).frame, None);
    let client = &link.client;
    assert!(!client.is_paused() && client.rotor_speed_rpm().is_none() && client.version().is_none());
    assert_eq!(link.drops().foreign, 101);
}

#[test]
fn no_session_has_the_indices_of_another() {
    let indices = || {
        let (simulator, _link) = Scripted::silent();
        ["sim/flightmodel/position/latitude", PAUSED, ROTOR_SPEED].map(|path| simulator.index(path))
    };
    let (one, other) = (indices(), indices());
    assert!(one.iter().all(|index| !other.contains(index)), "{one:?} {other:?}");
}

#[test]
fn a_spoofer_on_this_computer_cannot_deliver_a_frame() {
    let live = Live::start(0);
    let mut link = link_to(live.address, LOCAL);
    // The attack starts before the simulator's first reply, with a distant position and with the true one.
    let frames =
        under_attack(&mut link, &[FAR, SPOOFED], |link| (0..150).map(|_| next_frame(link)).collect::<Vec<_>>());
    assert_eq!(frames.iter().filter(|frame| is_spoofed(frame)).count(), 0);
    assert!(frames.windows(2).all(|pair| pair[0].time < pair[1].time));
    assert!(link.drops().foreign > 500, "{:?}", link.counters());
    assert_eq!(link.drops().malformed, 0);
}

#[test]
fn an_attack_delays_no_frames() {
    let live = Live::start(0);
    let mut link = link_to(live.address, LOCAL);
    next_frame(&mut link);
    let begin = now();
    under_attack(&mut link, &[FAR, SPOOFED], |link| (0..100).for_each(|_| assert!(!is_spoofed(&next_frame(link)))));
    let took = now() - begin;
    let counters = link.counters();
    assert!(took < Duration::from_millis(2500), "100 frames at 50 Hz took {took:?}: {counters:?}");
}

#[test]
fn a_simulator_that_replies_from_several_ports_is_flown() {
    let live = split();
    let mut link = link_to(live.address, LOCAL);
    let begin = now();
    next_frame(&mut link);
    assert!(now() < begin + Duration::from_secs(3), "learned after {:?}", now() - begin);
    let mut highest_m = 0.0_f64;
    // Senders that start later are refused, even while the aircraft flies away from its first place.
    let spoofed = under_attack(&mut link, &[FAR, SPOOFED], |link| {
        let mut spoofed = 0;
        for _ in 0..150 {
            link.command(Command::Controls(Controls { collective: 0.7, ..Controls::default() }));
            let frame = next_frame(link);
            spoofed += u32::from(is_spoofed(&frame));
            highest_m = highest_m.max(frame.measurement.height_m);
        }
        spoofed
    });
    assert_eq!(spoofed, 0);
    assert!(highest_m > 1.0, "the aircraft did not climb: {highest_m} m");
    assert!(link.drops().foreign > 100 && link.counters().skipped_frames < 20, "{:?}", link.counters());
}

#[test]
fn two_equally_credible_senders_deliver_no_frame() {
    let live = split();
    let mut link = link_to(live.address, LOCAL);
    under_attack(&mut link, &[SPOOFED], |link| {
        let until = now() + Duration::from_secs(3);
        while now() < until {
            assert_eq!(link.wait(SOON).frame, None);
        }
    });
    assert!(link.drops().foreign > 100, "{:?}", link.counters());
    assert!(!is_spoofed(&next_frame(&mut link)), "the simulator is trusted once the other sender has gone");
}

#[test]
fn a_simulator_that_restarts_on_other_ports_is_recognised_again() {
    for is_split in [false, true] {
        let options = |port| StandinOptions { split_ports: is_split, ..options(port) };
        let first = Live::run(Standin::open(&options(0)).unwrap());
        let address = first.address;
        let mut link = link_to(address, LOCAL);
        let before = next_frame(&mut link).time;
        drop(first);
        under_attack(&mut link, &[FAR], |link| {
            while let Some(frame) = link.wait(SOON).frame {
                assert!(!is_spoofed(&frame));
            }
            sleep_until(now() + Duration::from_millis(1100));
            let _again = Live::run(Standin::open(&options(address.port())).unwrap());
            let after = next_frame(link);
            assert!(after.time > before && !is_spoofed(&after));
        });
    }
}
