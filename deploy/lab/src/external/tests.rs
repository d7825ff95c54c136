use std::net::TcpStream;
use std::sync::mpsc::SyncSender;

use skein_core::formation::external::{Goal, Own};

use super::*;

fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

fn ask(vehicle: u8, tick: u64) -> Ask {
    let own = Own { position_ned_m: [0.0; 3], velocity_ned_m_s: [0.0; 3], heading_rad: 0.0, age_s: 0.0 };
    let goal = Goal {
        step: 0,
        centre_ned_m: [0.0; 3],
        centre_velocity_ned_m_s: [0.0; 3],
        heading_rad: 0.0,
        radius_m: 100.0,
        gamma: 1.0,
    };
    Ask { vehicle: id(vehicle), tick, time_s: 0.0, dt_s: 0.1, own, peers: Vec::new(), goal }
}

/// A law of these vehicles, and where what it says is put.
struct Script {
    conversation: Conversation,
    says: SyncSender<Word>,
    _far_end: TcpStream,
}

impl Script {
    fn of(vehicles: &[u8]) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let far_end = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let talk = Talk::connection(listener.accept().unwrap().0, |_, _| true).unwrap();
        let (says, words) = sync_channel(QUEUE);
        let vehicles = vehicles.iter().map(|&vehicle| id(vehicle)).collect();
        Self { conversation: Conversation::new(vehicles, talk, words), says, _far_end: far_end }
    }

    fn say(&self, line: &str) {
        self.says.send(Word::Data(line.as_bytes().to_vec())).unwrap();
    }

    fn answer(&self, vehicle: u8, tick: u64) {
        self.say(&format!(r#"{{"say":"answer","vehicle":{vehicle},"tick":{tick},"velocity_ned_m_s":[1,2,3]}}"#));
    }

    /// All are asked; who was answered.
    fn settle(&mut self, tick: u64) -> Vec<u8> {
        let asks: Vec<Ask> = self.conversation.vehicles.iter().map(|id| ask(id.get(), tick)).collect();
        let mut answered = Vec::new();
        let give = |answer: Answer| {
            assert_eq!(answer.tick, tick);
            answered.push(answer.vehicle.get());
        };
        self.conversation.settle(asks.iter().collect(), give).unwrap();
        answered
    }
}

#[test]
fn a_stray_line_costs_one_answer() {
    let too_much: [fn(&Script); 4] = [
        |law| law.say("debug"),
        |law| law.say("{}"),
        |law| law.say(r#"{"say":"ready","protocol":1}"#),
        |law| law.answer(9, 1),
    ];
    for stray in too_much {
        let mut law = Script::of(&[1]);
        stray(&law);
        (0..4).for_each(|tick| law.answer(1, tick));
        let answered: Vec<usize> = (0..4).map(|tick| law.settle(tick).len()).collect();
        assert_eq!(answered, [0, 1, 1, 1]);
    }
}

#[test]
fn of_several_vehicles_one_answer_is_lost() {
    let mut law = Script::of(&[1, 2, 3]);
    law.say("debug");
    (0..3).for_each(|tick| [3, 1, 2].iter().for_each(|&vehicle| law.answer(vehicle, tick)));
    assert_eq!([0, 1, 2].map(|tick| law.settle(tick)), [vec![3, 1], vec![3, 1, 2], vec![3, 1, 2]]);
    // A faulty answer is that of whoever has no other.
    law.answer(3, 3);
    law.say(r#"{"say":"answer","vehicle":1,"tick":3,"velocity_ned_m_s":null}"#);
    law.answer(2, 3);
    assert_eq!(law.settle(3), [3, 2]);
}

#[test]
fn an_answer_said_again_costs_nothing() {
    let mut law = Script::of(&[1, 2]);
    for tick in 0..3 {
        [1, 1, 2, 2, 1].iter().for_each(|&vehicle| law.answer(vehicle, tick));
    }
    (0..3).for_each(|tick| assert_eq!(law.settle(tick), [1, 2]));
}

#[test]
fn wrong_ticks_are_misses_and_no_more() {
    let mut law = Script::of(&[1]);
    for (tick, said) in [(0, 1), (1, 0), (2, 0), (3, 4), (4, 4)] {
        law.answer(1, said);
        assert_eq!(law.settle(tick).len(), usize::from(tick == said), "{said} to {tick}");
    }
}

#[test]
fn a_life_counts_its_asks_anew() {
    let mut law = Script::of(&[1]);
    law.answer(1, 0);
    assert_eq!(law.settle(0), [1]);
    let scenario = skein_common::scenario::load(
        &skein_common::scenario::Source { name: "test.toml", text: "swarm.vehicles = 1" },
        &[],
    );
    law.conversation.greet(&[Hello::new(&scenario.unwrap().scenario, id(1), Time::Virtual)]).unwrap();
    law.answer(1, 0);
    assert_eq!(law.settle(0), [1]);
}
