//! The orders that an agent accepts: an agent with an orders key, an operator, and a node that invents orders.

use super::*;
use crate::link::signature::VerificationKey;
use crate::link::signature::orders::sign;
use crate::link::signature::tests::signing_key;

const RUN: u64 = 77;

/// Trust of an agent that was started in a run and has the operator's key.
fn trust_in(swarm: &SwarmName, key: VerificationKey, run: u64) -> Trust {
    Trust { orders: Some(key), run, ..trust(swarm) }
}

fn order(epoch: u64, verb: Verb) -> Order {
    Order { epoch, issuer: 9, verb, vehicles: None, signature: None }
}

fn with_order(sender: u8, sequence: u64, order: Order) -> Heartbeat {
    Heartbeat { order: Some(order), ..mission(sender, sequence) }
}

/// Publishes a heartbeat again and again, with a new sequence number each time; returns what the inbox has of it.
fn store_heartbeat(link: &Link, session: &Session, sender: u8, order: Order) -> Heartbeat {
    let key = Topic::Mission(id(sender)).key();
    let mut sequence = 0;
    let again = || {
        sequence += 1;
        send(session, &key, &encode(&with_order(sender, sequence, order)));
    };
    until(link, again, |received| {
        received.iter().find_map(|received| match received.message {
            PeerMessage::Mission(content) if content.header.sender == id(sender) => Some(content),
            _ => None,
        })
    })
}

fn orders(received: &[Received]) -> Vec<Order> {
    received
        .iter()
        .filter_map(|received| if let PeerMessage::Order(order) = received.message { Some(order) } else { None })
        .collect()
}

/// The drops other than of messages that arrived again: a test repeats a message until it has arrived, and a repeat may
/// arrive at any time.
fn drops_without_repeats(link: &Link) -> Drops {
    Drops { old: 0, ..link.drops() }
}

/// Publishes `bad` orders until all are counted as refused, then the valid order `good` until it is stored; returns all
/// stored orders.
fn refused_then(link: &Link, session: &Session, bad: &[Order], good: Order) -> Vec<Order> {
    let before = link.drops().unsigned;
    let deadline = now() + TIMEOUT;
    while link.drops().unsigned < before + bad.len() as u64 {
        assert!(now() < deadline, "{:?}", link.drops());
        bad.iter().for_each(|order| send(session, &Topic::Order(order.issuer).key(), &encode(order)));
        pause();
    }
    let key = Topic::Order(good.issuer).key();
    until(
        link,
        || send(session, &key, &encode(&good)),
        |received| Some(orders(received)).filter(|orders| orders.contains(&good)),
    )
}

#[test]
fn only_an_order_signed_by_the_operator_in_this_run_is_accepted() {
    let (swarm, hub, dial) = hub("signed");
    let operator = signing_key();
    let agent = link(hub, 1, trust_in(&swarm, operator.key(), RUN));
    let session = open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    let good = sign(&operator, &swarm, Branch::SWARM, RUN, order(2, Verb::Hold));
    let bad = [
        order(9, Verb::Abort),
        sign(&signing_key(), &swarm, Branch::SWARM, RUN, order(9, Verb::Abort)),
        // From an earlier run: without the run's number it would be valid.
        sign(&operator, &swarm, Branch::SWARM, RUN - 1, order(9, Verb::Abort)),
        sign(&operator, &SwarmName::new("another").unwrap(), Branch::SWARM, RUN, order(9, Verb::Abort)),
        Order { verb: Verb::Abort, ..good },
    ];
    assert_eq!(refused_then(&agent, &session, &bad, good), [good]);
    // All bad orders were sent before the good one, in the same session: they are counted by now.
    let refused: Vec<_> =
        agent.receiver.inbox.refusals.latest().into_iter().filter(|kind| kind.reason != Reason::Old).collect();
    assert_eq!((refused.len(), refused[0].reason, refused[0].key.as_str()), (1, Reason::Unsealed, "order"));
    assert_eq!(drops_without_repeats(&agent), Drops { unsigned: refused[0].count, ..Drops::default() });
}

#[test]
fn an_order_invented_in_a_heartbeat_is_removed_and_counted() {
    let (swarm, hub, dial) = hub("made-up");
    let operator = signing_key();
    let agent = link(hub, 1, trust_in(&swarm, operator.key(), RUN));
    let node = open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    let made_up = order(u64::MAX, Verb::Abort);
    let filed = store_heartbeat(&agent, &node, 2, made_up);
    assert_eq!(filed, Heartbeat { order: None, ..with_order(2, filed.header.sequence, made_up) });

    // An order in another vehicle's heartbeat is valid if the operator has signed it.
    let signed = sign(&operator, &swarm, Branch::SWARM, RUN, order(1, Verb::Land));
    assert_eq!(store_heartbeat(&agent, &node, 3, signed).order, Some(signed));
    // The invented orders were sent before it, in the same session: they are counted by now.
    let refused = agent.receiver.inbox.refusals.latest();
    assert_eq!((refused.len(), refused[0].reason, refused[0].key.as_str()), (1, Reason::Unsealed, "vehicle/2/mission"));
    assert_eq!(agent.drops(), Drops { unsigned: refused[0].count, ..Drops::default() });
}

#[test]
fn without_an_orders_key_any_order_is_accepted() {
    let (swarm, hub, dial) = hub("plain");
    let agent = link(hub, 1, trust(&swarm));
    let session = open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    let plain = order(1, Verb::Hold);
    assert_eq!(refused_then(&agent, &session, &[], plain), [plain]);
    assert_eq!(store_heartbeat(&agent, &session, 2, order(2, Verb::Land)).order, Some(order(2, Verb::Land)));
    // Nothing is refused but the order itself, which is sent until it has arrived: once more, and it is old.
    assert!(
        agent
            .receiver
            .inbox
            .refusals
            .latest()
            .iter()
            .all(|kind| kind.reason == Reason::Old && kind.key.contains("order"))
    );
    assert_eq!(drops_without_repeats(&agent), Drops::default());
}

#[test]
fn an_agent_without_a_run_refuses_peers_with_a_run_and_signed_orders() {
    let (swarm, hub, dial) = hub("by-hand");
    let operator = signing_key();
    let by_hand = link(hub, 1, trust_in(&swarm, operator.key(), 0));
    let session = open_zenoh(&swarm, &[], &dial, &[]).unwrap();
    for sender in 2..9 {
        by_hand.receiver.store(
            "vehicle/2/mission",
            PeerMessage::Mission(mission(sender, 1)),
            Some(RUN),
            LocalTime::ZERO,
        );
    }
    assert_eq!((by_hand.receiver.trust.run, by_hand.drops().forged), (0, 7), "seven peers agree on a run");
    let bad = [
        sign(&operator, &swarm, Branch::SWARM, 0, order(9, Verb::Abort)),
        sign(&operator, &swarm, Branch::SWARM, RUN, order(9, Verb::Abort)),
    ];
    let deadline = now() + TIMEOUT;
    while by_hand.drops().unsigned < 4 {
        assert!(now() < deadline, "{:?}", by_hand.drops());
        bad.iter().for_each(|order| send(&session, &Topic::Order(order.issuer).key(), &encode(order)));
        pause();
    }
    let mut received = Vec::new();
    by_hand.drain(&mut received);
    assert_eq!(orders(&received), []);
}

#[test]
fn an_agent_with_a_run_refuses_messages_of_another_run() {
    let (swarm, hub, _) = hub("numbered");
    let agent = link(hub, 1, trust_in(&swarm, signing_key().key(), RUN));
    for sender in 2..9 {
        agent.receiver.store("vehicle/2/mission", PeerMessage::Mission(mission(sender, 1)), Some(5), LocalTime::ZERO);
    }
    assert_eq!(agent.receiver.trust.run, RUN);
    let mut received = Vec::new();
    agent.drain(&mut received);
    assert_eq!(received, [], "of another run");
    let refused = agent.receiver.inbox.refusals.latest();
    assert_eq!((refused[0].reason, refused[0].count), (Reason::OtherRun, 7));
    assert_eq!(agent.drops(), Drops { forged: 7, ..Drops::default() });
}

#[test]
fn strangers_other_plans_and_the_own_id_are_refused_and_counted() {
    let (swarm, hub, _) = hub("strangers");
    let agent = link(hub, 1, Trust { vehicles: 4, ..trust(&swarm) });
    let store = |key: &str, message| agent.receiver.store(key, message, None, LocalTime::ZERO);
    store("vehicle/9/cell/0/0/state", received_state(state(9, 1)));
    store("vehicle/5/alive", PeerMessage::Appeared(id(5)));
    store("vehicle/1/cell/0/0/state", received_state(state(1, 1)));
    let other_plan = Heartbeat { plan: 8, ..mission(2, 1) };
    store("vehicle/2/mission", PeerMessage::Mission(other_plan));
    store("vehicle/4/cell/0/0/state", received_state(state(4, 2)));
    store("vehicle/4/cell/3/0/state", received_state(state(4, 1)));
    let mut received = Vec::new();
    agent.drain(&mut received);
    let messages: Vec<PeerMessage> = received.iter().map(|received| received.message).collect();
    assert_eq!(
        messages,
        [PeerMessage::Mission(other_plan), received_state(state(4, 2))],
        "a vehicle with another plan still counts as up"
    );
    let named: Vec<_> =
        agent.receiver.inbox.refusals.latest().into_iter().map(|kind| (kind.reason, kind.key, kind.count)).collect();
    let expected = [
        (Reason::Old, "vehicle/4/state"),
        (Reason::OtherPlan, "vehicle/2/mission"),
        (Reason::Forged, "vehicle/1/state"),
        (Reason::UnknownVehicle, "vehicle/5/alive"),
        (Reason::UnknownVehicle, "vehicle/9/state"),
    ];
    assert_eq!(named, expected.map(|(reason, key)| (reason, key.to_owned(), 1)));
    assert_eq!(agent.drops(), Drops { forged: 3, other_plan: 1, old: 1, ..Drops::default() });
}
