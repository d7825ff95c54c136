//! Peers as other aircraft of a stand-in, in real time.

use skein_common::frame::{Attitude, PositionNed};
use skein_common::id::VehicleId;
use skein_common::scenario::{Source, load};

use super::live::{Live, read};
use super::*;

/// A peer that flies east at 2 m/s, 30 m north of the origin.
fn peer(since: Instant) -> PeerPose {
    let place = PositionNed::new(30.0, 2.0 * (now() - since).as_secs_f64(), -10.0);
    PeerPose {
        id: VehicleId::new(7).unwrap(),
        position: Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0)).geodetic_from_ned(place),
        attitude: Attitude { heading_rad: 90f64.to_radians(), ..Attitude::default() },
        distance_m: 30.0,
    }
}

/// The table `[plant]` of a scenario that draws so many peers.
fn drawing(show_peers: usize, acf: Option<&str>) -> VehicleModel {
    let plain = load(&Source { name: "plain", text: "swarm.vehicles = 1" }, &[]).unwrap().scenario.plant;
    VehicleModel { show_peers, peer_acf: acf.map(str::to_owned), ..plain }
}

#[test]
fn a_peer_is_drawn_where_it_is_at_the_frame_rate_and_its_aircraft_is_given_back() {
    let live = Live::start(0);
    let mut link = link_to(live.address, LOCAL);
    link.set_up(None, &drawing(3, Some("Aircraft/Skein/heli.acf"))).unwrap();
    let begin = now();
    let mut largest_m: f64 = 0.0;
    let mut places = Vec::new();
    for frame in 0..100 {
        next_frame(&mut link);
        link.show_peers(&mut [peer(begin)].into_iter());
        if frame % 10 == 9 {
            let local_m = read(live.address, "sim/multiplayer/position/plane1_x");
            places.push(local_m);
            largest_m = largest_m.max((f64::from(local_m) - 2.0 * (now() - begin).as_secs_f64()).abs());
        }
    }
    println!("drawn within {largest_m:.2} m of its place at 2 m/s");
    assert!(largest_m < 0.5, "{largest_m} m");
    assert!(places.windows(2).all(|pair| pair[1] > pair[0]), "it moves: {places:?}");
    let of = |field: &str| read(live.address, &format!("sim/multiplayer/position/plane1_{field}"));
    assert!((of("z") + 30.0).abs() < 0.1 && (of("el") - 10.0).abs() < 0.1 && (of("psi") - 90.0).abs() < 0.1);
    let taken = |number: u8| read(live.address, &format!("sim/operation/override/override_planepath[{number}]"));
    assert_eq!((taken(1), taken(2)), (1.0, 0.0));
    link.release();
    sleep_until(now() + Duration::from_millis(60));
    assert_eq!(taken(1), 0.0);
}

#[test]
fn a_simulator_that_is_not_there_is_sent_no_peers() {
    let (mut simulator, mut link) = Scripted::silent();
    link.set_up(None, &drawing(1, None)).unwrap();
    assert!(link.client.shows_peers());
    link.show_peers(&mut [peer(now())].into_iter());
    assert!(simulator.receive().is_empty());
    simulator.send_place(&link, &at_height(0.0));
    simulator.send_position(&link, at_height(0.0));
    next_frame(&mut link);
    link.show_peers(&mut [peer(now())].into_iter());
    assert!(simulator.receive().iter().any(|datagram| datagram.starts_with(b"VEHX")));
}
