use proptest::prelude::*;
use ring::rand::{SecureRandom, SystemRandom};
use skein_common::math::sin;

use super::*;

const FRAME_S: f64 = 0.02;

fn address(port: u16) -> SocketAddr {
    ([127, 0, 0, 1], port).into()
}

fn hovering() -> Position {
    Position { latitude_deg: 48.1, longitude_deg: 11.5, elevation_m: 530.0, height_m: 30.0, ..Position::default() }
}

/// A position `north_m` north of another.
fn moved_m(position: Position, north_m: f64) -> Position {
    Position { latitude_deg: position.latitude_deg + north_m / METRES_PER_DEGREE, ..position }
}

/// The senders' assessment over time, frame by frame.
struct Bench {
    senders: Senders,
    readings: Readings,
    at: Instant,
}

impl Bench {
    fn new() -> Self {
        Self { senders: Senders::default(), readings: Readings::default(), at: skein_host::clock::now() }
    }

    fn wait_s(&mut self, seconds: f64) {
        self.at += Duration::from_secs_f64(seconds);
    }

    /// Records values with our indices.
    fn values(&mut self, position: &Position) {
        self.readings.take(Reading::Latitude, position.latitude_deg as f32, self.at);
        self.readings.take(Reading::Longitude, position.longitude_deg as f32, self.at);
        self.readings.take(Reading::Elevation, position.elevation_m as f32, self.at);
    }

    fn position(&mut self, port: u16, position: &Position) -> Sender {
        self.senders.assess((address(port), self.at), position, &self.readings, FRAME_S, 1.0)
    }

    /// Runs frames with values and one position from each port; returns the assessment of the first port's last
    /// position.
    fn frames(&mut self, seconds: f64, from: &[(u16, Position)]) -> Sender {
        let mut last = Sender::Unproven;
        for _ in 0..(seconds / FRAME_S).round() as u32 {
            self.wait_s(FRAME_S);
            self.values(&hovering());
            for (nth, (port, position)) in from.iter().enumerate() {
                let sender = self.position(*port, position);
                last = if nth == 0 { sender } else { last };
            }
        }
        last
    }
}

#[test]
fn indices_are_distinct_and_of_one_session_only() {
    let draw = || Indices::draw(|bytes| SystemRandom::new().fill(bytes).is_ok()).unwrap();
    let (one, other) = (draw(), draw());
    assert!(one.values.iter().all(|index| *index >= 0 && other.value(*index).is_none()), "{one:?} {other:?}");
    for &value in Reading::ALL {
        assert_eq!(one.value(one.of(value)), Some(value));
    }
}

#[test]
fn only_the_queried_simulator_knows_the_indices() {
    let mut values = std::array::from_fn(|nth| 3000 + nth as i32);
    values[..5].copy_from_slice(&[5, 900, 17, 4000, 1000]);
    let indices = Indices { values, first_question: 20_000 };
    let assess = |answer: &[i32]| indices.assess(answer.iter().copied());
    assert_eq!(assess(&[5, 900, 17, 1000]), Provenance::Proof);
    assert_eq!(assess(&[5, 900, 17, 1]), Provenance::Proof, "with a subscription of an earlier program on this port");
    assert_eq!(assess(&[1000]), Provenance::Ours);
    assert_eq!(assess(&[1000, 1000, 1000, 5]), Provenance::Ours, "two different indices");
    assert_eq!(assess(&[1000, 5, 1]), Provenance::Foreign);
    assert_eq!(assess(&[1]), Provenance::Foreign);
    let guesses: Vec<i32> = (1..=183).collect();
    assert_eq!(assess(&guesses), Provenance::Foreign, "two indices were guessed by chance");
}

#[test]
fn the_port_of_the_values_is_trusted_at_once_and_no_other() {
    let mut bench = Bench::new();
    bench.senders.prove(address(49_000), bench.at);
    bench.values(&hovering());
    assert_eq!(bench.position(49_000, &hovering()), Sender::Simulator);
    assert!(matches!(bench.position(50_000, &hovering()), Sender::Foreign(_)), "even at the same place");
    assert!(matches!(bench.position(50_000, &moved_m(hovering(), 100.0)), Sender::Foreign(Some(_))));
    assert_eq!(
        bench.position(49_000, &moved_m(hovering(), 500.0)),
        Sender::Simulator,
        "the aircraft was placed elsewhere"
    );
}

#[test]
fn without_values_no_position_is_trusted() {
    let mut bench = Bench::new();
    for _ in 0..500 {
        bench.wait_s(FRAME_S);
        assert_eq!(bench.position(49_000, &hovering()), Sender::Unproven);
    }
}

#[test]
fn another_port_is_trusted_once_it_alone_has_agreed_for_the_trial() {
    let mut bench = Bench::new();
    assert_eq!(bench.frames(1.4, &[(49_001, hovering())]), Sender::Unproven);
    assert_eq!(bench.frames(0.2, &[(49_001, hovering())]), Sender::Simulator);
    assert_eq!(bench.frames(3.0, &[(49_001, hovering()), (50_000, hovering())]), Sender::Simulator);
    assert!(matches!(bench.position(50_000, &hovering()), Sender::Foreign(_)), "a later sender at the same place");
    assert!(matches!(bench.position(49_001, &moved_m(hovering(), 9.0)), Sender::Foreign(Some(_))));
}

#[test]
fn a_distant_sender_is_never_trusted() {
    let mut bench = Bench::new();
    let far = moved_m(hovering(), 30.0);
    assert!(matches!(bench.frames(10.0, &[(50_000, far)]), Sender::Foreign(Some(excess_m)) if excess_m > 25.0));
    assert_eq!(
        bench.frames(2.0, &[(49_001, hovering()), (50_000, far)]),
        Sender::Simulator,
        "a distant sender does not keep the simulator from being trusted"
    );
}

#[test]
fn of_two_senders_that_agree_neither_is_trusted_until_one_is_silent() {
    let mut bench = Bench::new();
    let both = [(49_001, hovering()), (50_000, moved_m(hovering(), 0.5))];
    assert_eq!(bench.frames(20.0, &both), Sender::Foreign(None));
    assert!(bench.senders.trusted.is_none());
    assert_eq!(bench.frames(2.0, &both[..1]), Sender::Simulator);
}

#[test]
fn a_proven_port_replaces_any_trusted_port() {
    let mut bench = Bench::new();
    assert_eq!(bench.frames(2.0, &[(50_000, hovering())]), Sender::Simulator, "there was no other sender");
    bench.senders.prove(address(49_000), bench.at);
    assert_eq!(bench.position(49_000, &hovering()), Sender::Simulator);
    assert!(matches!(bench.position(50_000, &hovering()), Sender::Foreign(_)));
}

#[test]
fn after_a_silence_the_old_port_is_trusted_at_once_and_a_new_one_after_a_trial() {
    let mut bench = Bench::new();
    assert_eq!(bench.frames(2.0, &[(49_001, hovering())]), Sender::Simulator);
    bench.wait_s(1.5);
    assert_eq!(bench.position(49_001, &hovering()), Sender::Unproven, "the values are as old as the silence");
    assert_eq!(bench.frames(0.02, &[(49_001, hovering())]), Sender::Simulator);
    bench.wait_s(1.5);
    assert_eq!(bench.frames(0.5, &[(49_501, hovering())]), Sender::Unproven);
    assert_eq!(bench.frames(1.2, &[(49_501, hovering())]), Sender::Simulator);
    assert!(matches!(bench.position(49_001, &hovering()), Sender::Foreign(_)));
}

#[test]
fn a_hovering_aircrafts_position_is_checked_to_two_metres() {
    let mut bench = Bench::new();
    bench.values(&hovering());
    bench.wait_s(FRAME_S);
    for (north_m, agrees) in [(0.0, true), (0.9, true), (-0.9, true), (2.5, false), (-2.5, false)] {
        let excess_m = excess_m(&moved_m(hovering(), north_m), &bench.readings, bench.at, FRAME_S, 1.0).unwrap();
        assert_eq!(excess_m <= 0.0, agrees, "{north_m} m: {excess_m}");
    }
    let up = Position { elevation_m: 532.0, ..hovering() };
    assert!(excess_m(&up, &bench.readings, bench.at, FRAME_S, 1.0).unwrap() > 0.9);
    let fast = Position { velocity_up_m_s: 500.0, ..moved_m(hovering(), 10.0) };
    assert!(excess_m(&fast, &bench.readings, bench.at, FRAME_S, 1.0).unwrap() > 0.0, "the claimed speed is limited");
}

proptest! {
    /// Positions of an honest simulator always agree: anywhere on the globe, at any speed, with values up to a quarter
    /// of a second older or a frame younger, rounded to single precision or truncated.
    #[test]
    fn an_honest_position_agrees(
        (latitude_deg, longitude_deg, elevation_m) in (-85.0..85.0_f64, -180.0..180.0_f64, -400.0..9000.0_f64),
        (speed_m_s, course_rad, climb_m_s) in (0.0..90.0_f64, 0.0..std::f64::consts::TAU, -15.0..15.0_f64),
        accelerations_m_s2 in prop::array::uniform3(-9.0..9.0_f64),
        age_s in 0.0..0.25_f64,
        lead_s in 0.0..FRAME_S,
        is_cut in any::<bool>(),
    ) {
        let single = |value: f64| {
            let rounded = value as f32;
            let is_outward = f64::from(rounded).abs() > value.abs();
            if is_cut && is_outward { rounded.signum() * rounded.abs().next_down() } else { rounded }
        };
        let mut bench = Bench::new();
        bench.readings.take(Reading::Latitude, single(latitude_deg), bench.at);
        bench.readings.take(Reading::Longitude, single(longitude_deg), bench.at);
        bench.readings.take(Reading::Elevation, single(elevation_m), bench.at);
        bench.wait_s(age_s);
        let t_s = age_s + lead_s;
        let [north, east, up] = accelerations_m_s2;
        let speeds = [
            speed_m_s * cos(course_rad) + north * t_s,
            speed_m_s * sin(course_rad) + east * t_s,
            climb_m_s + up * t_s,
        ];
        let displacement_m = |speed: f64, acceleration: f64| (speed - acceleration * t_s / 2.0) * t_s;
        let east_m_per_degree = METRES_PER_DEGREE * cos(latitude_deg.to_radians());
        let position = Position {
            latitude_deg: latitude_deg + displacement_m(speeds[0], north) / METRES_PER_DEGREE,
            longitude_deg: wrap_deg(longitude_deg + displacement_m(speeds[1], east) / east_m_per_degree),
            elevation_m: elevation_m + displacement_m(speeds[2], up),
            velocity_south_m_s: -speeds[0] as f32,
            velocity_east_m_s: speeds[1] as f32,
            velocity_up_m_s: speeds[2] as f32,
            ..Position::default()
        };
        let excess_m = excess_m(&position, &bench.readings, bench.at, FRAME_S, 1.0).unwrap();
        prop_assert!(excess_m <= 0.0, "{}", excess_m);
    }
}
