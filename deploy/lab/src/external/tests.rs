use std::net::TcpStream;
use std::sync::mpsc::SyncSender;

use skein_core::formation::external::OwnState;
use skein_core::formation::law::Goal;

use super::*;

fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

fn ask(vehicle: u8, tick: u64) -> LawQuery {
    let own = OwnState { position: [0.0; 3].into(), velocity: [0.0; 3].into(), heading_rad: 0.0, age_s: 0.0 };
    let goal = Goal {
        step: 0,
        centre: [0.0; 3].into(),
        centre_velocity: [0.0; 3].into(),
        heading_rad: 0.0,
        radius_m: 100.0,
        gamma: 1.0,
    };
    LawQuery { vehicle: id(vehicle), tick, time_s: 0.0, dt_s: 0.1, own, peers: Vec::new(), goal }
}

/// A scripted law of several vehicles, and the queue that holds what it sends.
struct Script {
    conversation: Conversation,
    law_output: SyncSender<LawInput>,
    _far_end: TcpStream,
}

impl Script {
    fn of(vehicles: &[u8]) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let far_end = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let session = LawSession::connection(listener.accept().unwrap().0, |_, _| true).unwrap();
        let (law_output, messages) = sync_channel(QUEUE);
        let vehicles = vehicles.iter().map(|&vehicle| id(vehicle)).collect();
        Self {
            conversation: Conversation::new(vehicles, session, messages, Default::default()),
            law_output,
            _far_end: far_end,
        }
    }

    fn say(&self, line: &str) {
        self.law_output.send(LawInput::Data(line.as_bytes().to_vec())).unwrap();
    }

    fn answer(&self, vehicle: u8, tick: u64) {
        self.say(&format!(r#"{{"say":"answer","vehicle":{vehicle},"tick":{tick},"velocity_ned_m_s":[1,2,3]}}"#));
    }

    /// Queries the law for every vehicle and returns the vehicles that got an answer.
    fn wait_for_answers(&mut self, tick: u64) -> Vec<u8> {
        let asks: Vec<LawQuery> = self.conversation.vehicles.iter().map(|id| ask(id.get(), tick)).collect();
        let mut answered = Vec::new();
        let give = |answer: LawReply| {
            assert_eq!(answer.tick, tick);
            answered.push(answer.vehicle.get());
        };
        self.conversation.wait_for_answers(asks.iter().collect(), None, give).unwrap();
        answered
    }
}

#[test]
fn a_law_that_starts_has_more_time_than_one_that_has_answered() {
    let set = Some(Duration::from_secs(2));
    assert_eq!([false, true].map(|has_answered| limit(has_answered, false, None)), [CONNECT_TIMEOUT, LAW_TIMEOUT]);
    assert_eq!([false, true].map(|has_answered| limit(has_answered, false, set)), [Duration::from_secs(2); 2]);
    // A model that gets datagrams may be started by hand.
    assert_eq!([false, true].map(|has_answered| limit(has_answered, true, set).as_secs()), [CONNECT_TIMEOUT_S, 2]);
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
        let answered: Vec<usize> = (0..4).map(|tick| law.wait_for_answers(tick).len()).collect();
        assert_eq!(answered, [0, 1, 1, 1]);
    }
}

#[test]
fn a_stray_line_costs_one_answer_of_several_vehicles() {
    let mut law = Script::of(&[1, 2, 3]);
    law.say("debug");
    (0..3).for_each(|tick| [3, 1, 2].iter().for_each(|&vehicle| law.answer(vehicle, tick)));
    assert_eq!([0, 1, 2].map(|tick| law.wait_for_answers(tick)), [vec![3, 1], vec![3, 1, 2], vec![3, 1, 2]]);
    // An invalid answer counts for the vehicle that got no other.
    law.answer(3, 3);
    law.say(r#"{"say":"answer","vehicle":1,"tick":3,"velocity_ned_m_s":null}"#);
    law.answer(2, 3);
    assert_eq!(law.wait_for_answers(3), [3, 2]);
}

#[test]
fn a_repeated_answer_costs_nothing() {
    let mut law = Script::of(&[1, 2]);
    for tick in 0..3 {
        [1, 1, 2, 2, 1].iter().for_each(|&vehicle| law.answer(vehicle, tick));
    }
    (0..3).for_each(|tick| assert_eq!(law.wait_for_answers(tick), [1, 2]));
}

#[test]
fn an_answer_with_a_wrong_tick_misses_only_its_own_query() {
    let mut law = Script::of(&[1]);
    for (tick, answered) in [(0, 1), (1, 0), (2, 0), (3, 4), (4, 4)] {
        law.answer(1, answered);
        assert_eq!(law.wait_for_answers(tick).len(), usize::from(tick == answered), "{answered} to {tick}");
    }
}

#[test]
fn the_ticks_of_a_restarted_agent_count_from_zero() {
    let mut law = Script::of(&[1]);
    law.answer(1, 0);
    assert_eq!(law.wait_for_answers(0), [1]);
    let scenario = skein_common::scenario::load(
        &skein_common::scenario::Source { name: "test.toml", text: "swarm.vehicles = 1" },
        &[],
    );
    law.conversation.send_hellos(&[Hello::new(&scenario.unwrap().scenario, id(1), Time::Virtual)]).unwrap();
    law.answer(1, 0);
    assert_eq!(law.wait_for_answers(0), [1]);
}

#[test]
fn a_kind_of_fault_is_reported_once_for_each_vehicle_however_many_sets_of_laws_a_study_has() {
    let pool = LawPool::default();
    let of_job = |vehicle: u8, pool: &LawPool| {
        let mut law = Script::of(&[vehicle]);
        law.conversation.warned = pool.warned.clone();
        law.conversation
    };
    let (one, same_vehicle, other) = (of_job(1, &pool), of_job(1, &pool.clone()), of_job(2, &pool));
    let fault = Fault::TooLong;
    assert!(one.is_first_of_its_kind(&fault) && !one.is_first_of_its_kind(&fault));
    assert!(!same_vehicle.is_first_of_its_kind(&fault), "another job of the same study");
    assert!(other.is_first_of_its_kind(&fault) && one.is_first_of_its_kind(&Fault::Late(3)));
}
