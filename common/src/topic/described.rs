//! The message under each key: which process sends it, which processes receive it, when, and how Zenoh carries it. The
//! documentation shows this table; [`crate::message`] has the fields of each message.

/// Description of one kind of message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TopicDescription {
    /// The key relative to the swarm's name, in a fleet below `team/` and the number of the team: `N` is a vehicle's id, `X` and `Y` are a cell, `ISSUER` is an operator's
    /// process.
    pub key: &'static str,
    /// Name of the message's struct; `None` for a key without a payload.
    pub message: Option<&'static str>,
    /// The process that sends it.
    pub sender: &'static str,
    /// The processes that receive it.
    pub receivers: &'static str,
    /// The occasions on which it is sent.
    pub when: &'static str,
    /// Zenoh's delivery settings.
    pub delivery: &'static str,
}

/// Descriptions of all kinds of messages, in the order of [`Topic`](super::Topic).
pub const TOPIC_DESCRIPTIONS: [TopicDescription; 10] = [
    TopicDescription {
        key: "vehicle/N/cell/X/Y/state",
        message: Some("State"),
        sender: "agent of vehicle N",
        receivers: "all other agents; in a fleet those of the team, and of other teams those that subscribe to the cell",
        when: "when the peers' dead reckoning of it would be off by `network.state_error_m` or `network.state_error_m_s`, at \
               the latest after `network.state_max_period_s`; every frame under `network.send = \"every_frame\"`",
        delivery: "put, priority real-time, best effort, express, dropped on congestion",
    },
    TopicDescription {
        key: "vehicle/N/cell/X/Y/intent",
        message: Some("Intent"),
        sender: "agent of vehicle N, in a fleet",
        receivers: "agents of other teams that subscribe to the cell",
        when: "once a second and at every change, in the cell of each area that it names",
        delivery: "put, priority interactive-high, dropped on congestion",
    },
    TopicDescription {
        key: "vehicle/N/alive",
        message: None,
        sender: "agent of vehicle N",
        receivers: "all other agents and observers",
        when: "from when the agent can receive until its sessions end",
        delivery: "liveliness token without a payload",
    },
    TopicDescription {
        key: "vehicle/N/health",
        message: Some("Health"),
        sender: "agent of vehicle N",
        receivers: "observers",
        when: "once a second",
        delivery: "put, priority data-high, dropped on congestion",
    },
    TopicDescription {
        key: "vehicle/N/mission",
        message: Some("Heartbeat"),
        sender: "agent of vehicle N",
        receivers: "all other agents and observers",
        when: "on every change of the agreement state, and five times a second",
        delivery: "put, priority interactive-high, dropped on congestion; an agent that comes late asks for the last one with a \
                   query under the same key",
    },
    TopicDescription {
        key: "vehicle/N/event",
        message: Some("Event"),
        sender: "agent of vehicle N",
        receivers: "observers",
        when: "once for each event",
        delivery: "put, priority data-high, dropped on congestion",
    },
    TopicDescription {
        key: "vehicle/N/trace",
        message: Some("Trace"),
        sender: "agent of vehicle N",
        receivers: "observers that want every step: `skein fly` and `skein record`",
        when: "every step, while a process subscribes to it; up to five wait for each other or for another message",
        delivery: "put, priority data-low, dropped on congestion",
    },
    TopicDescription {
        key: "vehicle/N/summary",
        message: Some("Summary"),
        sender: "agent of vehicle N",
        receivers: "`skein view`, ground stations and scripts",
        when: "at most ten times a second, while a process subscribes to it",
        delivery: "put, priority data, dropped on congestion; JSON",
    },
    TopicDescription {
        key: "vehicle/N/clock",
        message: Some("ClockAnswer"),
        sender: "agent of vehicle N",
        receivers: "the agent that asked",
        when: "on a query; each agent asks one peer after the other, every 0.5 s. The query carries its number, 8 bytes, \
               little-endian",
        delivery: "answer to a query, priority interactive-low, express, dropped on congestion",
    },
    TopicDescription {
        key: "order/ISSUER",
        message: Some("Order"),
        sender: "operator's process: `skein order`, `skein fly`, `skein cluster`",
        receivers: "all agents, which repeat the orders that they know in `Heartbeat.order`, each in turn",
        when: "on an operator's order, again until the swarm has taken it",
        delivery: "put, priority real-time, express, dropped on congestion",
    },
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::id::VehicleId;
    use crate::topic::{Cell, Topic};

    #[test]
    fn every_topic_is_described_once_in_order() {
        let id = VehicleId::new(7).unwrap();
        let topics = [
            Topic::State(id, Cell { x: 1, y: 2 }),
            Topic::Intent(id, Cell { x: 1, y: 2 }),
            Topic::Alive(id),
            Topic::Health(id),
            Topic::Mission(id),
            Topic::Event(id),
            Topic::Trace(id),
            Topic::Summary(id),
            Topic::Clock(id),
            Topic::Order(12),
        ];
        let fill_in = |part: &str| match part {
            "N" => "7".to_owned(),
            "X" => "1".to_owned(),
            "Y" => "2".to_owned(),
            "ISSUER" => "12".to_owned(),
            _ => part.to_owned(),
        };
        let keys =
            TOPIC_DESCRIPTIONS.map(|description| description.key.split('/').map(fill_in).collect::<Vec<_>>().join("/"));
        assert_eq!(keys, topics.map(|topic| topic.key()));
    }
}
