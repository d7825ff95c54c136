//! Draws peers as the simulator's other aircraft.
//!
//! X-Plane has up to 19 aircraft beside the user's own. VEHX sets the pose of one and stops its flight model: it stays
//! there until the next message, so that each is moved in every frame. A peer keeps its aircraft while it is among the
//! nearest, and is replaced only by one that is clearly nearer. How an aircraft is given back is not documented; X-Plane's
//! own override of its path is the likely way.

use std::time::{Duration, Instant};

use skein_common::id::VehicleId;
use skein_core::plant::PeerPose;

use super::Send;
use crate::plant::xplane::convert;
use crate::plant::xplane::wire::WireError;
use crate::plant::xplane::wire::aircraft::Load;
use crate::plant::xplane::wire::dref::Write;

/// Number of aircraft beside the user's own.
const AIRCRAFT: usize = 19;
/// A peer replaces another one if its distance is less than this share of the other's.
const CLEARLY_NEARER: f64 = 0.8;
/// Time between two loads: X-Plane draws no frames while it loads an aircraft.
const LOAD_PERIOD: Duration = Duration::from_secs(1);

/// One of the simulator's other aircraft.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ShownAircraft {
    /// The peer that it shows.
    peer: Option<VehicleId>,
    /// Whether its file has been loaded.
    is_loaded: bool,
    /// Whether its flight model has been stopped.
    is_taken: bool,
}

/// The simulator's other aircraft that show peers; the first is number 1.
#[derive(Debug, Default)]
pub(super) struct PeerTraffic {
    pub(super) aircraft: Vec<ShownAircraft>,
    /// Path of the file that is loaded for each.
    acf: Option<String>,
    last_load: Option<Instant>,
}

impl PeerTraffic {
    /// Shows up to this number of peers, with this aircraft file if there is one.
    ///
    /// # Errors
    /// If the path does not fit into a message.
    pub(super) fn new(most: usize, acf: Option<&str>) -> Result<Self, WireError> {
        if let Some(path) = acf {
            Load { aircraft: 1, path, livery: 0 }.encode(&mut Vec::new())?;
        }
        let aircraft = vec![ShownAircraft::default(); most.min(AIRCRAFT)];
        Ok(Self { aircraft, acf: acf.map(str::to_owned), last_load: None })
    }

    /// The simulator has been restarted, so it has not loaded any of the files yet.
    pub(super) fn simulator_restarted(&mut self) {
        self.aircraft.iter_mut().for_each(|aircraft| (aircraft.is_loaded, aircraft.is_taken) = (false, false));
    }

    /// Puts the aircraft to the poses of the nearest peers, and gives those back that show none.
    pub(super) fn show(&mut self, peers: &[PeerPose], now: Instant, out: &mut Vec<u8>, send: Send<'_>) {
        self.assign(peers);
        for (number, aircraft) in (1..).zip(&mut self.aircraft) {
            let pose = aircraft.peer.and_then(|id| peers.iter().find(|peer| peer.id == id));
            let Some(pose) = pose else {
                give_back(number, aircraft, out, send);
                aircraft.is_taken = false;
                continue;
            };
            if let Some(path) = self.acf.as_ref().filter(|_| !aircraft.is_loaded) {
                if self.last_load.is_some_and(|last| now < last + LOAD_PERIOD) {
                    continue;
                }
                self.last_load = Some(now);
                aircraft.is_loaded = Load { aircraft: number, path, livery: 0 }.encode(out).is_ok();
                send(out);
            }
            convert::peer(pose, number).encode(out);
            send(out);
            aircraft.is_taken = true;
        }
    }

    /// Gives all aircraft back.
    pub(super) fn release(&self, out: &mut Vec<u8>, send: Send<'_>) {
        for (number, aircraft) in (1..).zip(&self.aircraft) {
            give_back(number, aircraft, out, send);
        }
    }

    /// Assigns the nearest peers to aircraft; a peer that is shown keeps its own.
    fn assign(&mut self, peers: &[PeerPose]) {
        let distance_m = |id: VehicleId| peers.iter().find(|peer| peer.id == id).map(|peer| peer.distance_m);
        for aircraft in &mut self.aircraft {
            aircraft.peer = aircraft.peer.filter(|id| distance_m(*id).is_some());
        }
        let mut waiting: Vec<&PeerPose> =
            peers.iter().filter(|peer| self.aircraft.iter().all(|aircraft| aircraft.peer != Some(peer.id))).collect();
        waiting.sort_unstable_by(|a, b| a.distance_m.total_cmp(&b.distance_m).then(a.id.cmp(&b.id)));
        for peer in waiting {
            // A free aircraft counts as one that shows a peer at an infinite distance.
            let shown_m = |aircraft: &ShownAircraft| aircraft.peer.and_then(distance_m).unwrap_or(f64::INFINITY);
            let farthest = self.aircraft.iter_mut().rev().max_by(|a, b| shown_m(a).total_cmp(&shown_m(b)));
            match farthest {
                Some(farthest) if peer.distance_m < CLEARLY_NEARER * shown_m(farthest) => {
                    farthest.peer = Some(peer.id);
                }
                _ => return,
            }
        }
    }
}

fn give_back(number: u8, aircraft: &ShownAircraft, out: &mut Vec<u8>, send: Send<'_>) {
    let path = format!("sim/operation/override/override_planepath[{number}]");
    if aircraft.is_taken && (Write { value: 0.0, path: &path }).encode(out).is_ok() {
        send(out);
    }
}

#[cfg(test)]
mod tests {
    use skein_common::frame::{Attitude, Geodetic};

    use super::*;
    use crate::plant::xplane::wire::aircraft::{ACFN, Move};
    use skein_host::clock::now;

    fn peers(distances_m: &[(u8, f64)]) -> Vec<PeerPose> {
        let pose = |&(id, distance_m): &(u8, f64)| PeerPose {
            id: VehicleId::new(id).unwrap(),
            position: Geodetic::from_degrees(28.0, -82.0, f64::from(id)),
            attitude: Attitude::default(),
            distance_m,
        };
        distances_m.iter().map(pose).collect()
    }

    fn shown(traffic: &PeerTraffic) -> Vec<u8> {
        traffic.aircraft.iter().map(|aircraft| aircraft.peer.map_or(0, |id| id.get())).collect()
    }

    /// The datagrams of one frame.
    fn frame(traffic: &mut PeerTraffic, distances_m: &[(u8, f64)], now: Instant) -> Vec<Vec<u8>> {
        let mut sent = Vec::new();
        traffic.show(&peers(distances_m), now, &mut Vec::new(), &mut |datagram| sent.push(datagram.to_vec()));
        sent
    }

    #[test]
    fn the_nearest_peers_are_shown_and_each_keeps_its_aircraft() {
        let mut traffic = PeerTraffic::new(2, None).unwrap();
        let mut at = |distances_m: &[(u8, f64)]| {
            traffic.assign(&peers(distances_m));
            shown(&traffic)
        };
        assert_eq!(at(&[]), [0, 0]);
        assert_eq!(at(&[(7, 50.0)]), [7, 0]);
        assert_eq!(at(&[(2, 60.0), (3, 40.0), (7, 50.0)]), [7, 3]);
        assert_eq!(at(&[(2, 45.0), (3, 40.0), (7, 50.0)]), [7, 3], "nearer, but not clearly");
        assert_eq!(at(&[(2, 39.0), (3, 40.0), (7, 50.0)]), [2, 3], "clearly nearer than vehicle 7");
        assert_eq!(at(&[(2, 45.0), (3, 40.0), (7, 44.0)]), [2, 3], "and not replaced at once");
        assert_eq!(at(&[(3, 40.0), (7, 44.0)]), [7, 3], "vehicle 2 has left");
        assert_eq!(at(&[(7, 44.0)]), [7, 0]);
        assert_eq!(shown(&PeerTraffic::new(40, None).unwrap()).len(), 19);
    }

    #[test]
    fn an_aircraft_that_shows_no_peer_any_more_is_given_back_once() {
        let mut traffic = PeerTraffic::new(3, None).unwrap();
        let sent = frame(&mut traffic, &[(4, 10.0), (5, 20.0)], now());
        let moved: Vec<_> = sent.iter().map(|datagram| Move::decode(datagram).unwrap().aircraft).collect();
        assert_eq!(moved, [1, 2]);
        let sent = frame(&mut traffic, &[(5, 20.0)], now());
        let written = Write::decode(&sent[0]).unwrap();
        assert_eq!((written.path, written.value), ("sim/operation/override/override_planepath[1]", 0.0));
        assert_eq!((sent.len(), Move::decode(&sent[1]).unwrap().aircraft), (2, 2));
        assert_eq!(frame(&mut traffic, &[(5, 20.0)], now()).len(), 1);
        let mut released = Vec::new();
        traffic.release(&mut Vec::new(), &mut |datagram| released.push(datagram.to_vec()));
        assert_eq!(Write::decode(&released[0]).unwrap().path, "sim/operation/override/override_planepath[2]");
        assert_eq!(released.len(), 1, "the others were never taken, or are given back already");
    }

    #[test]
    fn one_aircraft_file_a_second_is_loaded_and_again_after_a_restart() {
        let mut traffic = PeerTraffic::new(2, Some("Aircraft/heli.acf")).unwrap();
        let begin = now();
        let loads = |traffic: &mut PeerTraffic, after_s: f64| {
            let sent = frame(traffic, &[(4, 10.0), (5, 20.0)], begin + Duration::from_secs_f64(after_s));
            let loads = sent.iter().filter(|datagram| datagram.starts_with(&ACFN)).count();
            (loads, sent.len() - loads)
        };
        assert_eq!(loads(&mut traffic, 0.0), (1, 1));
        assert_eq!(loads(&mut traffic, 0.5), (0, 1), "the second aircraft waits");
        assert_eq!(loads(&mut traffic, 1.0), (1, 2));
        assert_eq!(loads(&mut traffic, 2.0), (0, 2));
        traffic.simulator_restarted();
        assert_eq!(loads(&mut traffic, 3.0), (1, 1));
        assert!(PeerTraffic::new(2, Some(&"a".repeat(150))).is_err());
    }
}
