//! Secured links between teams of a fleet. Each certificate is for one vehicle of one team.

use super::super::teams::{HOME, strangers, team_trust};
use super::*;

/// The vehicles, one of each team. Their certificates are named like those that `skein cluster keys` makes.
const FLEET: [(&str, &str); 3] = [("1/1", "vehicle-1-1"), ("2/1", "vehicle-2-1"), ("3/1", "vehicle-3-1")];

fn tls(authority: &Authority, certificate: &str) -> Tls {
    let known = |name: &str| PeerIdentity { name: name.to_owned(), key: authority.signing_key(name).key() };
    let vehicles = FLEET.map(|(vehicle, certificate)| (vehicle.parse().unwrap(), known(certificate))).into();
    Tls { vehicles, ..authority.tls(certificate) }
}

fn link(authority: &Authority, swarm: &SwarmName, team: u16, sessions: Sessions) -> Link {
    let certificate = format!("vehicle-{team}-1");
    let trust = Trust {
        key_ring: secured(tls(authority, &certificate)).key_ring(swarm),
        signing_key: Some(authority.signing_key(&certificate)),
        orders: Some(authority.signing_key("operator").key()),
        run: RUN,
        ..team_trust(swarm, team)
    };
    Link::new(sessions, id(1), LocalClock::start(), trust).unwrap()
}

#[test]
fn a_vehicle_is_received_by_other_teams_under_its_own_team_only() {
    let swarm = SwarmName::new(format!("secured-teams-{}", process::id())).unwrap();
    let authority = Authority::new();
    let open = |listen: &[String], dial: &[String], certificate: &str| {
        Sessions::open(&swarm, listen, dial, &secured(tls(&authority, certificate))).unwrap()
    };
    let hub = open(&["tls/127.0.0.1:0".to_owned()], &[], "vehicle-1-1");
    let dial = hub.endpoints();
    let own = link(&authority, &swarm, 1, hub);
    let stranger = link(&authority, &swarm, 2, open(&[], &dial, "vehicle-2-1"));
    // Without this link, messages in the name of 3/1 would be refused because it is not up.
    let third = open(&[], &dial, "vehicle-3-1");
    wait_until(|| is_linked(third.first()));
    own.subscribe_to(vec![HOME]);
    stranger.subscribe_to(vec![HOME]);
    let mut sequence = 0;
    let mut publish = |link: &Link| {
        sequence += 1;
        link.publish_state(&state(1, sequence), HOME);
    };
    let is = |name: &'static str| move |state: &StrangerState| state.id.to_string() == name;
    strangers(&own, || publish(&stranger), is("2/1"));
    strangers(&stranger, || publish(&own), is("1/1"));

    let signing_key = authority.signing_key("vehicle-2-1");
    let key_ring = secured(tls(&authority, "vehicle-2-1")).key_ring(&swarm);
    let forge = || {
        for key in ["team/3/vehicle/1/cell/0/0/state", "team/3/vehicle/1/cell/0/0/intent", "team/1/vehicle/1/mission"] {
            let forged = State { header: forged_header(1), ..state(1, 1) };
            send(stranger.sessions.first(), key, &key_ring.write(Some(&signing_key), RUN, key, &forged));
            send(stranger.sessions.first(), key, &encode(&forged));
        }
        publish(&stranger);
    };
    let received = strangers(&own, forge, |state| is("2/1")(state) && own.drops().forged >= 20);
    assert!(received.iter().all(is("2/1")), "{received:?}");
    let mut members = Vec::new();
    own.drain(&mut members);
    assert_eq!(members.iter().find(|received| is_forged(&received.message)), None);
}
