//! One or two clients with a simulator, in virtual time.

use std::net::SocketAddr;

use clap::{Args, FromArgMatches};
use skein_common::frame::{Geodetic, PositionNed};
use skein_common::message::ShortText;
use skein_host::clock::now;

use super::*;
use crate::plant::xplane::server::DEFAULT_ACF;
use crate::plant::xplane::standin::{Simulator, StandinOptions};

const FRAME: Duration = Duration::from_millis(20);
const SIMULATOR: SocketAddr = SocketAddr::new(IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), 49_000);

impl Client {
    /// The rotor's speed as last received.
    pub(in crate::plant::xplane) fn rotor_speed_rpm(&self) -> Option<f32> {
        self.readings.last(Reading::RotorSpeed)
    }
}

/// A simulator with its clients.
struct Bench {
    simulator: Simulator,
    clients: Vec<Client>,
    now: Instant,
    /// The command of each client in every frame, if it has one.
    commands: Vec<Option<f64>>,
}

impl Bench {
    /// A simulator whose clients have drawn these numbers.
    fn new(seeds: &[u8]) -> Self {
        Self::of(seeds, &Profile::default())
    }

    /// The same with this profile.
    fn of(seeds: &[u8], profile: &Profile) -> Self {
        let defaults = StandinOptions::augment_args(clap::Command::new("standin")).get_matches_from(["standin"]);
        let options = StandinOptions::from_arg_matches(&defaults).unwrap();
        let client = |&seed: &u8| {
            let mut next = u32::from(seed) << 24;
            let indices = Indices::draw(|bytes| {
                for index in bytes.chunks_mut(4) {
                    next += 1;
                    index.copy_from_slice(&next.to_le_bytes());
                }
                true
            });
            Client::new(&origin(), profile, 50, indices.unwrap())
        };
        Self {
            simulator: Simulator::new(&options).unwrap(),
            clients: seeds.iter().map(client).collect(),
            now: now(),
            commands: vec![None; seeds.len()],
        }
    }

    /// Runs for so many seconds; the roll of a commanding client changes with time. Returns how often each client had its
    /// command written in the last second.
    fn run(&mut self, for_s: f64) -> Vec<u64> {
        let frames = (for_s * 50.0) as u32;
        let mut written = vec![0; self.clients.len()];
        for frame in 0..frames {
            self.now += FRAME;
            for (nth, client) in self.clients.iter_mut().enumerate() {
                let mut sent = Vec::new();
                client.renew(self.now, &mut |datagram| sent.push(datagram.to_vec()));
                if let Some(collective) = self.commands[nth] {
                    let roll = 0.1 * (nth as f64 + 1.0) + 1e-4 * f64::from(frame % 100);
                    let controls = Controls { roll, collective, ..Controls::default() };
                    let before = client.counters.withheld_commands;
                    client.command(Command::Controls(controls), self.now, &mut |datagram| sent.push(datagram.to_vec()));
                    let is_written = client.counters.withheld_commands == before;
                    written[nth] += u64::from(is_written && frame + 50 >= frames);
                }
                for datagram in sent {
                    self.simulator.receive(&datagram, from(nth));
                }
            }
            let (frame_s, _) = self.simulator.begin_frame();
            let mut sent = Vec::new();
            self.simulator.end_frame(frame_s, |to, datagram| sent.push((to, datagram.to_vec())));
            for (to, datagram) in sent {
                for (nth, client) in self.clients.iter_mut().enumerate().filter(|(nth, _)| from(*nth) == to) {
                    client.receive(&datagram, SIMULATOR, SIMULATOR.ip(), self.now);
                    let _ = (nth, client.frame());
                }
            }
        }
        written
    }

    fn standstill(&mut self, nth: usize) -> Option<Standstill> {
        self.clients[nth].standstill(self.now)
    }
}

fn from(nth: usize) -> SocketAddr {
    SocketAddr::new(SIMULATOR.ip(), 30_000 + nth as u16)
}

fn origin() -> Origin {
    Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0))
}

#[test]
fn one_client_has_the_controls_and_no_other_program_is_suspected() {
    let mut bench = Bench::new(&[1]);
    bench.commands = vec![Some(0.3)];
    assert_eq!(bench.run(20.0), [50]);
    assert_eq!(bench.standstill(0), None);
}

#[test]
fn an_aircraft_that_another_program_flies_is_left_to_it_until_that_program_ends() {
    let mut bench = Bench::new(&[1, 2]);
    bench.commands = vec![Some(0.3), None];
    bench.run(5.0);
    bench.commands[1] = Some(0.3);
    assert_eq!(bench.run(10.0), [50, 0]);
    assert_eq!((bench.standstill(0), bench.standstill(1)), (None, Some(Standstill::Occupied)));
    bench.commands[0] = None;
    assert_eq!(bench.run(4.0)[1], 50, "the first one has ended and left its override");
    assert_eq!(bench.standstill(1), None);
}

#[test]
fn of_two_programs_that_begin_together_one_leaves_the_aircraft_to_the_other() {
    for seeds in [[1, 2], [2, 1], [5, 6], [9, 40]] {
        let mut bench = Bench::new(&seeds);
        bench.commands = vec![Some(0.3); 2];
        let mut written = bench.run(20.0);
        written.sort_unstable();
        assert_eq!(written, [0, 50], "{seeds:?}");
    }
}

#[test]
fn an_aircraft_elsewhere_on_the_ground_is_placed_and_one_in_the_air_is_not() {
    let away = |bench: &mut Bench, start: PositionNed| {
        (origin().ned_from_geodetic(&bench.simulator.truth().measurement.position) - start).norm()
    };
    let start = PositionNed::new(80.0, -40.0, 0.0);
    let place = origin().geodetic_from_ned(start);
    let placement = Placement {
        aircraft: 0,
        latitude_deg: place.latitude_rad.to_degrees(),
        longitude_deg: place.longitude_rad.to_degrees(),
        elevation_m: 0.0,
        heading_deg: 30.0,
        speed_m_s: 0.0,
    };
    let mut bench = Bench::new(&[1]);
    bench.clients[0].placing = Some(Placing::at(placement));
    bench.run(0.5);
    assert!(away(&mut bench, start) < 1.0, "{}", away(&mut bench, start));
    bench.run(0.5);
    assert_eq!(bench.standstill(0), None);

    let mut bench = Bench::new(&[1]);
    bench.commands = vec![Some(0.9)];
    while bench.simulator.truth().measurement.height_m < 10.0 {
        bench.run(0.1);
    }
    bench.clients[0].placing = Some(Placing::at(placement));
    bench.run(0.5);
    assert!(away(&mut bench, start) > 50.0 && bench.standstill(0).is_none());
}

#[test]
fn another_aircraft_than_the_profile_is_for_is_not_flown() {
    for (acf, expected) in [("xcell60", None), ("R22", Some(Standstill::OtherAircraft(ShortText::of(DEFAULT_ACF))))] {
        let mut bench = Bench::of(&[1], &Profile { acf: Some(acf.to_owned()), ..Profile::default() });
        bench.clients[0].inquire();
        bench.run(2.0);
        assert_eq!(bench.standstill(0), expected, "{acf}");
        assert_eq!(bench.clients[0].counters.foreign, 0, "its own questions are answered");
    }
}
