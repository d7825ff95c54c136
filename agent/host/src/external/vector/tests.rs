use proptest::prelude::*;
use skein_common::id::VehicleId;

use super::*;
use skein_core::formation::external::OwnState;
use skein_core::formation::law::Goal;

fn id(number: u8) -> VehicleId {
    VehicleId::new(number).unwrap()
}

fn peer(number: u8, north_m: f64) -> Neighbour {
    Neighbour {
        id: id(number),
        position: [north_m, 3.2, -30.1].into(),
        velocity: [0.5, 0.2, 0.1].into(),
        heading_rad: 7.0,
        age_s: 0.06,
        is_fresh: true,
    }
}

fn ask(peers: Vec<Neighbour>) -> LawQuery {
    LawQuery {
        vehicle: id(3),
        tick: 417,
        time_s: 41.7,
        dt_s: 0.1,
        own: OwnState {
            position: [81.0, -60.2, -30.0].into(),
            velocity: [0.1, 0.4, 0.3].into(),
            heading_rad: 1.57,
            age_s: 0.0,
        },
        peers,
        goal: Goal {
            step: 2,
            centre: [11.0, 12.0, -30.0].into(),
            centre_velocity: [1.0, 2.0, 3.0].into(),
            heading_rad: 0.5,
            radius_m: 100.0,
            gamma: 4.0,
        },
    }
}

/// Values of a datagram, by their indices counted from 1.
fn values(datagram: &[u8]) -> impl Fn(usize) -> f64 + use<> {
    let values: Vec<f64> = datagram.chunks(8).map(|chunk| f64::from_le_bytes(chunk.try_into().unwrap())).collect();
    assert_eq!(values.len(), ASK);
    move |index| values[index - 1]
}

#[test]
fn a_query_has_its_values_at_these_indices() {
    let at = values(&write(&ask(vec![peer(1, 99.1), peer(2, 50.0)])));
    let head = [1.0, 3.0, 417.0, 41.7, 0.1, 2.0, 81.0, -60.2, -30.0, 0.1, 0.4, 0.3, 1.57];
    let goal = [11.0, 12.0, -30.0, 1.0, 2.0, 3.0, 0.5, 100.0, 4.0, 2.0, 0.0];
    let rows = [1.0, 99.1, 3.2, -30.1, 0.5, 0.2, 0.1, 0.06, 2.0, 50.0];
    for (index, value) in head.iter().chain(&goal).chain(&rows).enumerate() {
        assert_eq!(at(index + 1), *value, "value {}", index + 1);
    }
    assert!((41..=144).all(|index| at(index) == 0.0));
}

#[test]
fn of_many_peers_the_nearest_have_a_row_by_id() {
    let peers: Vec<Neighbour> = (4..=24).map(|number| peer(number, 81.0 + 10.0 * f64::from(25 - number))).collect();
    let at = values(&write(&ask(peers)));
    let ids: Vec<f64> = (0..15).map(|k| at(25 + 8 * k)).collect();
    assert_eq!((at(23), ids), (15.0, (10..=24).map(f64::from).collect()));
}

fn datagram(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

#[test]
fn a_reply_has_its_values_at_these_indices() {
    let answer = read(&datagram(&[1.0, 3.0, 417.0, 1.0, 0.4, -1.2, 0.1, 1.5, 1.0])).unwrap();
    assert_eq!((answer.vehicle, answer.tick, answer.heading_rad), (id(3), 417, Some(1.5)));
    assert_eq!(answer.command, ReplyCommand::VelocityNed(Vector3::new(0.4, -1.2, 0.1)));
    let answer = read(&datagram(&[1.0, 3.0, 417.0, 2.0, 0.4, -1.2, 0.0, 1.5, 0.0])).unwrap();
    assert_eq!((answer.command, answer.heading_rad), (ReplyCommand::FieldNe(Vector2::new(0.4, -1.2)), None));
}

#[test]
fn malformed_replies_are_refused_by_kind() {
    let good = [1.0, 3.0, 417.0, 1.0, 0.4, -1.2, 0.1, 1.5, 1.0];
    let with = |index: usize, value: f64| {
        let mut values = good;
        values[index - 1] = value;
        read(&datagram(&values)).map(drop).unwrap_err()
    };
    assert_eq!(read(&datagram(&good)[..71]), Err(Fault::Length(71, 72)));
    assert_eq!(read(&datagram(&[0.0; 10])), Err(Fault::Length(80, 72)));
    assert_eq!(read(&[]), Err(Fault::Length(0, 72)));
    assert_eq!(with(1, 2.0), Fault::Protocol);
    assert_eq!(with(2, 300.0), Fault::Vehicle(300));
    for (index, value) in [(2, 0.5), (3, -1.0), (4, 3.0), (5, f64::NAN), (7, f64::INFINITY), (6, 1e300), (8, 1e10)] {
        assert!(matches!(with(index, value), Fault::Content(_)), "{value} at {index}");
    }
}

/// A number as an answer has it at this place, or any other.
fn at_place(good: f64) -> impl Strategy<Value = f64> {
    prop_oneof![8 => Just(good), 1 => any::<f64>(), 1 => -3.0..300.0_f64, 1 => (-3..300_i32).prop_map(f64::from)]
}

proptest! {
    #[test]
    fn a_datagram_of_another_length_is_refused_with_its_length(datagram in proptest::collection::vec(any::<u8>(), 0..200)) {
        prop_assume!(datagram.len() != 8 * ANSWER);
        prop_assert_eq!(read(&datagram), Err(Fault::Length(datagram.len(), 8 * ANSWER)));
    }

    #[test]
    fn numbers_are_an_answer_exactly_when_each_is_one_that_its_place_can_hold(
        mut values in [1.0, 3.0, 417.0, 1.0, 0.4, -1.2, 0.1, 1.5, 1.0].map(at_place),
        is_field in any::<bool>(),
    ) {
        if is_field && values[3] == 1.0 {
            values[3] = 2.0;
        }
        let [protocol, vehicle, tick, kind, x, y, z, heading_rad, is_meant] = values;
        let is_whole = |number: f64, most: f64| number.fract() == 0.0 && (0.0..most).contains(&number);
        let is_answer = values.iter().all(|number| number.abs() <= 1e9)
            && protocol == 1.0
            && is_whole(vehicle, 251.0)
            && vehicle > 0.0
            && is_whole(tick, 9e15)
            && [1.0, 2.0].contains(&kind);
        let read = read(&datagram(&values));
        prop_assert_eq!(read.is_ok(), is_answer, "{:?}", read);
        if let Ok(answer) = read {
            prop_assert_eq!((f64::from(answer.vehicle.get()), answer.tick as f64), (vehicle, tick));
            prop_assert_eq!(answer.heading_rad, (is_meant == 1.0).then_some(heading_rad));
            let command = match kind {
                1.0 => ReplyCommand::VelocityNed(Vector3::new(x, y, z)),
                _ => ReplyCommand::FieldNe(Vector2::new(x, y)),
            };
            prop_assert_eq!(answer.command, command);
        }
    }
}
