//! The messages of a node with a link that are accepted.

use super::*;

/// The other tests rely on this: without signatures every forged message is accepted.
#[test]
fn without_signatures_a_valid_node_could_forge_any_message() {
    let swarm = Swarm::without_signatures("unsigned");
    let intruder = swarm.guest(swarm.authority.tls("vehicle-3.2"));
    let forger = Forger {
        key_ring: KeyRing::plain(swarm.name.clone()),
        signing_key: swarm.authority.signing_key("vehicle-3.2"),
    };
    wait_until(|| is_linked(intruder.first()));
    let mut received = Vec::new();
    let deadline = now() + TIMEOUT;
    let kinds: [fn(&PeerMessage) -> bool; 3] = [
        |message| matches!(message, PeerMessage::State(_)),
        |message| matches!(message, PeerMessage::Mission(_)),
        |message| matches!(message, PeerMessage::Order(_)),
    ];
    let are_received = |received: &[Received]| {
        kinds.iter().all(|kind| message(received, |message| is_forged(message) && kind(message)).is_some())
    };
    while !are_received(&received) {
        assert!(now() < deadline, "{received:?}");
        forger.forge(intruder.first(), &[1, 2]);
        forge_order(intruder.first());
        swarm.one.drain(&mut received);
        pause();
    }
}

#[test]
fn a_node_with_a_valid_certificate_can_use_every_kind_of_message() {
    let mut swarm = Swarm::begin("honest");
    let observer = swarm.guest(swarm.authority.tls("observer"));
    let operator = swarm.guest(swarm.authority.tls("operator"));
    let observer = observer.first();
    let mut kinds = [all::STATES, all::MISSIONS, all::EVENTS, all::HEALTH].map(|key| samples(observer, key));
    let mut traces = samples(observer, all::TRACES);
    let tokens = observer.liveliness().declare_subscriber(all::ALIVE).history(true).wait().unwrap();
    wait_until(|| swarm.one.trace_is_wanted() && swarm.two.trace_is_wanted());
    let mut publishers = [&swarm.one, &swarm.two].map(|link| link.health(|| 0).unwrap());

    let mut there = BTreeSet::new();
    let mut received_kinds = [false; 4];
    let deadline = now() + TIMEOUT;
    while there.len() < 2 || received_kinds != [true; 4] {
        assert!(now() < deadline, "tokens {there:?}, received {received_kinds:?}");
        swarm.exchange(1, || {});
        swarm.one.publish_mission(&mission(1, 1));
        swarm.two.publish_event(&Event { header: state(2, 1).header, what: EventKind::Landed });
        for publisher in publishers.iter().flat_map(|health| &health.publisher.publishers) {
            publisher.put(b"health").wait().unwrap();
        }
        there.extend(tokens.drain().map(|token| token.key_expr().as_str().to_owned()));
        for (is_received, new) in received_kinds.iter_mut().zip(&mut kinds) {
            *is_received |= !new().is_empty();
        }
    }
    assert_eq!(traces().len(), 0, "no vehicle has published a trace");

    // A late observer queries for heartbeats.
    let answers = observer.get("vehicle/*/mission").timeout(TIMEOUT).wait().unwrap();
    let keys: Vec<String> = answers.iter().map(|reply| reply.result().unwrap().key_expr().to_string()).collect();
    assert_eq!(keys, ["vehicle/1/mission"]);

    // Each vehicle queries the other's clock.
    for (health, other) in publishers.iter_mut().zip([2, 1]) {
        let mut peers =
            [PeerHealth { id: id(other), standing: PeerStatus::Fresh, age_s: 0.0, delay_s: None, clock: None }];
        health.live = vec![id(other)];
        let (deadline, mut query_due) = (now() + TIMEOUT, QueryDue(now()));
        while peers[0].clock.is_none() {
            assert!(now() < deadline, "vehicle {other} does not reply with its time");
            if query_due.is_now() {
                health.query_next_clock();
            }
            pause();
            crate::link::clocks::report(&mut health.measurements.lock(), &mut peers, now());
        }
    }

    let order = Order { epoch: 1, issuer: 9, verb: Verb::Land, vehicles: None, signature: None };
    let order =
        signature::orders::sign(&swarm.authority.signing_key("operator"), &swarm.name, Branch::SWARM, RUN, order);
    for link in [&swarm.one, &swarm.two] {
        let give = || send(operator.first(), &Topic::Order(9).key(), &encode(&order));
        until(link, give, |received| message(received, |message| *message == PeerMessage::Order(order)));
    }
}

#[test]
fn a_late_vehicle_receives_the_heartbeats_of_its_peers() {
    let swarm = Swarm::begin("late-secured");
    swarm.one.publish_mission(&mission(1, 5));
    let _late = first_to_receive(mission(1, 5), || {
        let trust = swarm.authority.trust(&swarm.name, "vehicle-3.2");
        let sessions = swarm.guest(swarm.authority.tls("vehicle-3.2"));
        Link::new(sessions, id(3), LocalClock::start(), trust).unwrap()
    });
    until(&swarm.two, || {}, |received| message(received, |message| *message == PeerMessage::Appeared(id(3))));
}

/// Vehicle 3's own messages arrive, so the ones that it forged before were refused.
#[test]
fn a_valid_vehicle_can_send_for_itself_only() {
    let mut swarm = Swarm::begin("branch");
    let intruder = swarm.guest(swarm.authority.tls("vehicle-3.2"));
    wait_until(|| is_linked(intruder.first()));
    let forger = swarm.forger("vehicle-3.2");
    let mut sequence = 0;
    for receiver in [1, 2] {
        for _ in 0..5 {
            attack(intruder.first(), &forger);
            sequence += 1;
            let link = if receiver == 1 { &swarm.one } else { &swarm.two };
            let received = until(
                link,
                || forger.send(intruder.first(), Topic::State(id(3), Cell::default()), &state(3, sequence)),
                |received| {
                    message(received, |message| *message == received_state(state(3, sequence)))
                        .map(|_| received.to_vec())
                },
            );
            assert_eq!(received.iter().find(|received| is_forged(&received.message)), None);
        }
    }
    swarm.refuse(|| attack(intruder.first(), &forger));
}

/// A vehicle that starts late queries for heartbeats; vehicle 3's replies for other vehicles are refused.
#[test]
fn a_valid_vehicle_can_reply_for_itself_only() {
    let swarm = Swarm::begin("reply");
    swarm.one.publish_mission(&mission(1, 5));
    let own = swarm.authority.tls("vehicle-3.2");
    let forger = swarm.forger("vehicle-3.2");
    let intruder = Sessions::open(&swarm.name, &["tls/127.0.0.1:0".to_owned()], &[], &secured(own)).unwrap();
    let answer = move |query: Query| {
        for sender in [1, 3] {
            let forged = Heartbeat { header: forged_header(sender), ..mission(sender, 1) };
            let key = Topic::Mission(id(sender)).key();
            // Zenoh rejects a reply under a key that was not queried.
            let _ = query.reply(&key, forger.key_ring.write(Some(&forger.signing_key), RUN, &key, &forged)).wait();
        }
    };
    // It declares itself complete for all vehicles.
    let _answers =
        intruder.first().declare_queryable("vehicle/*/mission").complete(true).callback(answer).wait().unwrap();
    let _token = intruder.first().liveliness().declare_token(Topic::Alive(id(3)).key()).wait().unwrap();
    let dial = [&swarm.endpoints[..1], &intruder.endpoints()].concat();
    let sessions = Sessions::open(&swarm.name, &[], &dial, &secured(swarm.authority.tls("vehicle-2"))).unwrap();
    let trust = swarm.authority.trust(&swarm.name, "vehicle-2");
    let late = Link::new(sessions, id(2), LocalClock::start(), trust).unwrap();
    // Queried repeatedly, because the intruder's link may come up later than vehicle 1's.
    let mut query_due = QueryDue(now());
    let ask = || {
        if !query_due.is_now() {
            return;
        }
        for sender in [1, 3] {
            let receiver = late.receiver.clone();
            queries::send_query(late.sessions.first(), Topic::Mission(id(sender)).key(), &[], move |sample| {
                receive(&receiver, sample, LocalClock::start());
            });
        }
    };
    let received = until(&late, ask, |received| {
        (late.drops().forged > 0).then_some(())?;
        message(received, |message| *message == PeerMessage::Mission(mission(1, 5)))?;
        message(received, |message| is_forged(message) && message.sender() == Some(id(3))).map(|_| received.to_vec())
    });
    assert_eq!(message(&received, |message| is_forged(message) && message.sender() == Some(id(1))), None);
}

/// A guest is linked to the feed, where nothing but orders and queries is received.
#[test]
fn observers_and_operators_cannot_send_for_a_vehicle() {
    for who in ["observer", "operator"] {
        let mut swarm = Swarm::begin(&format!("{who}-forges"));
        let intruder = swarm.guest(swarm.authority.tls(who));
        wait_until(|| is_linked(intruder.first()));
        let forger = swarm.forger(who);
        swarm.refuse_orders_alone(|| attack(intruder.first(), &forger));
    }
}

/// The sessions that a vehicle flies with are linked with the other vehicle only, however many guests there are.
#[test]
fn guests_are_linked_to_the_feed_and_receive_what_the_vehicles_publish() {
    let mut swarm = Swarm::begin("feed");
    let guests: Vec<_> = ["observer", "operator"].map(|who| swarm.guest(swarm.authority.tls(who))).into();
    let mut received: Vec<_> = guests.iter().map(|guest| samples(guest.first(), "vehicle/**")).collect();
    let mut kinds = vec![BTreeSet::new(); guests.len()];
    let deadline = now() + TIMEOUT;
    let expected: BTreeSet<String> =
        ["vehicle/1/mission", "vehicle/1/state", "vehicle/2/mission", "vehicle/2/state"].map(str::to_owned).into();
    while kinds.iter().any(|kinds| *kinds != expected) {
        assert!(now() < deadline, "{kinds:?}");
        swarm.exchange(1, || {});
        swarm.one.publish_mission(&mission(1, swarm.sequence));
        swarm.two.publish_mission(&mission(2, swarm.sequence));
        for (kinds, received) in kinds.iter_mut().zip(&mut received) {
            kinds.extend(received().iter().map(|sample| sample.key_expr().as_str().replace("cell/0/0/", "")));
        }
    }
    for link in [&swarm.one, &swarm.two] {
        let flown = link.sessions.all.iter().map(|session| session.info().peers_zid().wait().count());
        assert_eq!(flown.sum::<usize>(), 1, "the other vehicle");
        let feed = link.sessions.feed.as_ref().unwrap();
        assert_eq!(feed.info().peers_zid().wait().count(), guests.len());
    }
}

/// A guest may declare only so much in one link, because the feed remembers it until the link ends.
#[test]
fn a_guest_that_declares_without_end_loses_its_link_and_delays_no_vehicle() {
    let mut swarm = Swarm::begin("declares");
    let tls = swarm.authority.tls("observer");
    // Otherwise it would end the link itself, when a declaration is not accepted at once.
    let patient = ("transport/link/tx/queue/congestion_control/block/wait_before_close", json!(60_000_000));
    let open =
        |listen: &[String], dial: &[String]| open_zenoh(&swarm.name, listen, dial, std::slice::from_ref(&patient));
    let intruder = Sessions::open_through(Tunnel::open(&[], &swarm.endpoints, Some(&tls)).unwrap(), open).unwrap();
    let links = |link: &Link| link.sessions.feed.as_ref().unwrap().info().peers_zid().wait().count();
    wait_until(|| [&swarm.one, &swarm.two].iter().all(|link| links(link) == 1));
    let is_over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        scopeguard::defer! { is_over.store(true, Relaxed) }
        scope.spawn(|| {
            let mut subscribers = Vec::new();
            while !is_over.load(Relaxed) {
                let key = format!("nothing/{}", subscribers.len());
                subscribers.push(intruder.first().declare_subscriber(key).callback(|_| {}).wait().unwrap());
            }
        });
        let mut keep = [true; 2];
        let deadline = now() + Duration::from_secs(60);
        while keep.contains(&true) {
            assert!(now() < deadline, "links are kept: {keep:?}");
            swarm.exchange(1, || {});
            for (keep, link) in keep.iter_mut().zip([&swarm.one, &swarm.two]) {
                *keep &= links(link) == 1;
            }
        }
    });
    swarm.exchange(ROUNDS, || {});
}

/// Vehicle 3 replays vehicle 1's messages, after vehicle 1 has gone, to an agent that never received them.
#[test]
fn replayed_messages_are_refused_once_their_sender_has_gone() {
    let swarm = Swarm::begin("replay");
    let intruder = swarm.guest(swarm.authority.tls("vehicle-3.2"));
    let mut kept = samples(intruder.first(), "vehicle/1/**");
    let deadline = now() + TIMEOUT;
    let mut messages = Vec::new();
    while messages.len() < 2 {
        assert!(now() < deadline);
        swarm.one.publish_mission(&mission(1, 1));
        let bytes_by_key = |sample: &Sample| (sample.key_expr().to_string(), sample.payload().to_bytes().into_owned());
        messages.extend(kept().iter().map(bytes_by_key));
        pause();
    }
    let Swarm { one, two, authority, name, .. } = swarm;
    one.close();
    until(&two, || {}, |received| message(received, |message| *message == PeerMessage::Vanished(id(1))));
    two.close();
    let here = ["tls/127.0.0.1:0".to_owned()];
    let sessions = Sessions::open(&name, &here, &[], &secured(authority.tls("vehicle-2"))).unwrap();
    let dial = sessions.endpoints();
    let newcomer = Link::new(sessions, id(2), LocalClock::start(), authority.trust(&name, "vehicle-2")).unwrap();
    let again = Sessions::open(&name, &[], &dial, &secured(authority.tls("vehicle-3.2"))).unwrap();
    let again = again.first();
    let mut received = Vec::new();
    let deadline = now() + TIMEOUT;
    while newcomer.drops().old < 20 {
        assert!(now() < deadline, "{:?}", newcomer.drops());
        messages.iter().for_each(|(key, bytes)| send(again, key, bytes));
        drop(again.liveliness().declare_token(Topic::Alive(id(1)).key()).wait().unwrap());
        newcomer.drain(&mut received);
        pause();
    }
    assert_eq!(message(&received, |message| message.sender() == Some(id(1))), None);
}

/// Zenoh identifies a session by a number (Zenoh id) that all its linked nodes see.
#[test]
fn no_node_can_replace_another_by_taking_its_session_number() {
    let mut swarm = Swarm::begin("number");
    let all = [&swarm.one, &swarm.two].map(|link| link.sessions.all.iter().map(|session| session.zid().to_string()));
    let [ones, twos] = all.map(Iterator::collect::<Vec<_>>);
    let valid = swarm.authority.tls("vehicle-3.2");
    let forger = swarm.forger("vehicle-3.2");
    let intruders: Vec<_> = [(&ones, 1), (&twos, 0)]
        .into_iter()
        .flat_map(|(numbers, victim)| numbers.iter().map(move |number| (number, victim)))
        .map(|(number, victim)| as_number(&swarm, number, &[], &swarm.endpoints[victim..=victim], &valid))
        .collect();
    assert_eq!(intruders.len(), 3, "vehicle 1 dials no peer");
    swarm.withstand(|| intruders.iter().for_each(|intruder| attack(intruder.first(), &forger)));
}

/// A dialled node can still take the number of another dialled node and then send over that node's session, but only
/// with its own signature.
#[test]
fn no_node_can_send_for_another_by_taking_its_session_number() {
    let swarm = Swarm::begin("taken-number");
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let of_intruder = vec![format!("tls/{free}")];
    let dial = [&swarm.endpoints[..1], &of_intruder].concat();
    let tls = swarm.authority.tls("vehicle-3.2");
    let sessions = Sessions::open(&swarm.name, &["tls/127.0.0.1:0".to_owned()], &dial, &secured(tls)).unwrap();
    let trust = swarm.authority.trust(&swarm.name, "vehicle-3.2");
    let three = Link::new(sessions, id(3), LocalClock::start(), trust).unwrap();
    until(&three, || {}, |received| message(received, |message| *message == PeerMessage::Appeared(id(1))));

    let number = swarm.one.sessions.first().zid().to_string();
    let intruder = as_number(&swarm, &number, &of_intruder, &[], &swarm.authority.tls("vehicle-2"));
    let forger = swarm.forger("vehicle-2");
    let mut received = Vec::new();
    let deadline = now() + TIMEOUT;
    while three.drops().forged < 20 {
        assert!(now() < deadline, "{:?}", three.drops());
        forger.forge(intruder.first(), &[1]);
        three.drain(&mut received);
        pause();
    }
    assert_eq!(message(&received, is_forged), None);
}

/// Opens sessions with a chosen number.
fn as_number(swarm: &Swarm, number: &str, listen: &[String], dial: &[String], tls: &Tls) -> Sessions {
    let chosen = [("id", json!(number))];
    let tunnel = Tunnel::open(listen, dial, Some(tls)).unwrap();
    Sessions::open_through(tunnel, |listen, dial| open_zenoh(&swarm.name, listen, dial, &chosen)).unwrap()
}
