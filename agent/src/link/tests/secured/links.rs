//! The nodes that get a link, and what they can do with it.

use super::*;

#[test]
fn a_node_without_a_certificate_is_refused() {
    let mut swarm = Swarm::begin("none");
    // First plain TCP to the right address, then TLS without a certificate.
    let address = swarm.endpoints[0].trim_start_matches("tls/").to_owned();
    let plain = open_zenoh(&swarm.name, &[], &[format!("tcp/{address}")], &[]).unwrap();
    // A valid signature does not help.
    let forger = swarm.forger("vehicle-1");
    swarm.receive_nothing_forged(|| attack(&plain, &forger));
    assert!(!is_linked(&plain));

    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_file(swarm.authority.folder.path().join("authority.pem")).unwrap()).unwrap();
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()));
    let config = config.with_protocol_versions(&[&TLS13]).unwrap().with_root_certificates(roots).with_no_client_auth();
    let mut tls = ClientConnection::new(Arc::new(config), "127.0.0.1".try_into().unwrap()).unwrap();
    let mut socket = TcpStream::connect(address).unwrap();
    let ended = Stream::new(&mut tls, &mut socket).read(&mut [0; 1]);
    assert!(ended.is_err(), "{ended:?}");
    wait_until(|| swarm.one.receiver.inbox.refusals.latest().iter().any(|kind| kind.reason == Reason::Link));
}

#[test]
fn a_certificate_of_another_authority_is_refused() {
    let mut swarm = Swarm::begin("other");
    // The intruder accepts the swarm's certificates, but not vice versa.
    let others = Authority::new();
    let tls = Tls { authority: swarm.authority.folder.path().join("authority.pem"), ..others.tls("vehicle-3.2") };
    let intruder = swarm.guest(tls);
    let forger = swarm.forger("vehicle-1");
    swarm.receive_nothing_forged(|| attack(intruder.first(), &forger));
    assert!(!is_linked(intruder.first()));
}

#[test]
fn an_expired_certificate_is_refused() {
    let mut swarm = Swarm::begin("expired");
    let tls = swarm.authority.tls("vehicle-3.2");
    swarm.authority.certify("vehicle-3.2", 2021);
    let intruder = swarm.guest(tls);
    let forger = swarm.forger("vehicle-1");
    swarm.receive_nothing_forged(|| attack(intruder.first(), &forger));
    assert!(!is_linked(intruder.first()));
}

#[test]
fn a_node_with_a_replaced_certificate_name_is_refused() {
    let mut swarm = Swarm::begin("revoked");
    let intruder = swarm.guest(swarm.authority.tls("vehicle-3"));
    let forger = swarm.forger("vehicle-1");
    swarm.receive_nothing_forged(|| attack(intruder.first(), &forger));
    assert!(!is_linked(intruder.first()));
    assert!(swarm.one.drops().links > 0 && swarm.two.drops().links > 0, "the refused links are counted");
}

#[test]
fn a_node_with_a_replaced_key_is_refused() {
    // The lost key's certificate has the right name and has not expired.
    let lost = Authority::new();
    let mut swarm = Swarm::begin("lost");
    let tls = swarm.authority.tls("vehicle-3.2");
    fs::copy(lost.key_file("vehicle-3.2"), &tls.key).unwrap();
    swarm.authority.certify("vehicle-3.2", 2100);
    let intruder = swarm.guest(tls);
    let forger = swarm.forger("vehicle-1");
    swarm.receive_nothing_forged(|| attack(intruder.first(), &forger));
    assert!(!is_linked(intruder.first()));
    assert!(swarm.one.drops().links > 0 && swarm.two.drops().links > 0, "the refused links are counted");
}

/// Peers do not relay messages, but a router would, if the peers accepted that.
#[test]
fn a_router_gets_no_forged_message_through() {
    let mut swarm = Swarm::begin("router");
    let router = [("mode", json!("router"))];
    let tunnel = Tunnel::open(&[], &swarm.endpoints, Some(&swarm.authority.tls("vehicle-3.2"))).unwrap();
    let intruder =
        Sessions::open_through(tunnel, |listen, dial| open_zenoh(&swarm.name, listen, dial, &router)).unwrap();
    let forger = swarm.forger("vehicle-3.2");
    swarm.withstand(|| attack(intruder.first(), &forger));
}

/// Zenoh waits half a second for the declarations of a session that it dials; peers that are up are reached earlier.
#[test]
fn opening_a_session_does_not_wait_for_peers_that_are_up() {
    let swarm = Swarm::begin("early");
    let opens = (0..8).map(|_| {
        let begun = now();
        let guest = swarm.guest(swarm.authority.tls("observer"));
        let opened = now() - begun;
        guest.close(());
        opened
    });
    let shortest = opens.min().unwrap();
    assert!(shortest < Duration::from_millis(500), "{shortest:?}");
}

#[test]
fn errors_name_the_key_file_or_name_at_fault() {
    let authority = Authority::new();
    let name = SwarmName::new("named").unwrap();
    let good = authority.tls("vehicle-1");
    let refused = |tls: Tls, listen: &str| {
        let Err(error) = Sessions::open(&name, &[listen.to_owned()], &[], &secured(tls)) else {
            panic!("the sessions were opened")
        };
        error.to_string()
    };
    let here = "tls/127.0.0.1:0";
    let missing = authority.folder.path().join("missing.pem");
    let named = missing.display().to_string();
    let error = refused(Tls { certificate: missing, ..good.clone() }, here);
    assert!(error.starts_with(&named) && error.contains("No such file"), "{error}");
    let error = refused(Tls { key: good.certificate.clone(), ..good.clone() }, here);
    assert!(error.ends_with("vehicle-1.pem: no PRIVATE KEY in it"), "{error}");
    let error = refused(good.clone(), "tcp/127.0.0.1:0");
    assert_eq!(error, "\"tcp/127.0.0.1:0\": links are secured here; write the endpoint like tls/10.0.0.11:7447");
    let Err(error) = Sessions::open(&name, &[], &[here.to_owned()], &Security::Plain) else {
        panic!("the sessions were opened")
    };
    assert!(error.is_user_error() && error.to_string().contains("no keys for secured links"), "{error}");
    let mut vehicles = good.vehicles.clone();
    vehicles.insert(id(4).into(), vehicles[&id(1).into()].clone());
    assert!(refused(Tls { vehicles, ..good.clone() }, here).contains("\"vehicle-1\" must name exactly one"));
    assert!(
        refused(Tls { observers: vec!["vehicle-2".to_owned()], ..good.clone() }, here).contains("\"vehicle-2\" must")
    );
    let other = authority.key_file("vehicle-2");
    assert!(
        refused(Tls { key: other, ..good.clone() }, here).contains("vehicle-2.key: "),
        "the key of another certificate"
    );

    let signing_key = |tls: Tls, own: u8| secured(tls).signing_key(id(own).into());
    assert!(
        signing_key(good.clone(), 1).unwrap().is_some() && Security::Plain.signing_key(id(1).into()).unwrap().is_none()
    );
    let error = signing_key(good.clone(), 2).unwrap_err();
    assert!(
        error.is_user_error() && error.to_string().ends_with("the key that the swarm has for vehicle 2"),
        "{error}"
    );
    let error = signing_key(Tls { key: good.certificate.clone(), ..good }, 1).unwrap_err().to_string();
    assert!(error.ends_with("vehicle-1.pem: not an Ed25519 key in PKCS#8"), "{error}");
}

#[test]
fn links_over_ipv6_are_secured_too() {
    let authority = Authority::new();
    let name = SwarmName::new(format!("six-{}", process::id())).unwrap();
    let tls = |number| secured(authority.tls(&format!("vehicle-{number}")));
    if TcpListener::bind("[::1]:0").is_err() {
        // This computer has no IPv6.
        return;
    }
    let one = Sessions::open(&name, &["tls/[::1]:0".to_owned()], &[], &tls(1)).unwrap();
    let two = Sessions::open(&name, &[], &one.endpoints(), &tls(2)).unwrap();
    wait_until(|| is_linked(two.first()));
}

/// With Zenoh's own TLS links this ended the process within seconds.
#[test]
fn links_that_come_and_go_do_not_disturb_the_swarm() {
    const GUESTS: usize = 3;
    const VISITS: usize = 12;
    let name = SwarmName::new(format!("busy-{}", process::id())).unwrap();
    let authority = Authority::new();
    let here = ["tls/127.0.0.1:0".to_owned()];
    let (mut endpoints, mut links) = (Vec::new(), Vec::new());
    for (own, vehicle) in (1..).zip(["vehicle-1", "vehicle-2", "vehicle-3.2"]) {
        let sessions = Sessions::open(&name, &here, &endpoints, &secured(authority.tls(vehicle))).unwrap();
        endpoints.extend(sessions.endpoints());
        links.push((own, Link::new(sessions, id(own), LocalClock::start(), authority.trust(&name, vehicle)).unwrap()));
    }
    let observer = secured(authority.tls("observer"));
    let (name, endpoints, observer) = (&name, &endpoints, &observer);
    let still_come = &AtomicUsize::new(GUESTS);
    let all_went = || still_come.load(Relaxed) == 0;
    std::thread::scope(|scope| {
        for (own, link) in links {
            scope.spawn(move || {
                let (mut sequence, mut received) = (0, Vec::new());
                while !all_went() {
                    sequence += 1;
                    link.publish_state(&state(own, sequence), Cell::default());
                    link.publish_mission(&mission(own, sequence));
                    pause();
                    link.drain(&mut received);
                }
                let others = [1, 2, 3].into_iter().filter(|other| *other != own);
                for other in others {
                    let is_others = |message: &PeerMessage| {
                        matches!(message, PeerMessage::State(_)) && message.sender() == Some(id(other))
                    };
                    assert!(
                        message(&received, is_others).is_some(),
                        "vehicle {own} has not received a state of vehicle {other}"
                    );
                }
                assert_eq!(link.drops().refused(), 0);
            });
        }
        for _ in 0..GUESTS {
            scope.spawn(move || {
                let _gone = Gone(still_come);
                for _ in 0..VISITS {
                    let sessions = Sessions::open(name, &[], endpoints, observer).unwrap();
                    let mut received = samples(sessions.first(), all::STATES);
                    wait_until(|| !received().is_empty());
                    drop(received);
                    sessions.close(());
                }
            });
        }
    });
}

/// Decrements a count when dropped, also if its test fails.
struct Gone<'a>(&'a AtomicUsize);

impl Drop for Gone<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Relaxed);
    }
}
