//! Ten thousand hostile datagrams a second at the simulator's port of a flying agent, from another program on its PC:
//! malformed ones, positions close to the true one, the values of a subscription that the agent does not have. No vehicle
//! leaves its place or its track, and every datagram is counted by its kind, or was dropped by the system because the port's
//! queue was full.

use skein_tests::share::Share;
use std::f64::consts::TAU;
use std::fs;
use std::net::{Ipv4Addr, UdpSocket};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::Pid;
use skein_agent::plant::xplane::wire::rpos::Position;
use skein_agent::plant::xplane::wire::rref;
use skein_cluster::mesh::observe::Observer;
use skein_common::frame::{Origin, PositionNed, wrap_rad};
use skein_common::id::VehicleId;
use skein_common::message::{Drops, Trace};
use skein_common::scenario::Scenario;
use skein_common::state::Activity;
use skein_lab::metrics::largest_gap_deviation_rad;

use super::flight::{Flight, command, wait_for};

/// Datagrams a second.
const RATE_HZ: u32 = 10_000;
/// Datagrams sent together.
const BURST: u32 = 10;
/// Share of the rate below which the attack counts as too weak.
const LEAST_SHARE: f64 = 0.9;
/// Largest distance from its place or track that a vehicle may move, m.
const STAYS_WITHIN_M: f64 = 1.0;
/// Longest time until a ring is even and steady, and largest deviation of its gaps then, degrees.
const STEADY_WITHIN: Duration = Duration::from_secs(400);
const EVEN_DEG: f64 = 1.0;
/// How long the track of a ring is measured before the attack, and how far from it a vehicle of a steady ring may be, m: an
/// even ring still closes in on its radius for a minute.
const MEASURED: Duration = Duration::from_secs(30);
const STEADY_M: f64 = 0.2;
/// Speed below which a vehicle stands in the air, m/s.
const STANDING_M_S: f64 = 0.1;
/// Health reports come once a second.
const COUNTED_AFTER: Duration = Duration::from_secs(3);

/// A socket of a process, as the system shows it.
#[derive(Clone, Copy, Debug)]
struct Socket {
    port: u16,
    /// Number of datagrams that the system dropped because the queue was full.
    dropped: u64,
}

/// The UDP sockets of a process over IPv4.
fn sockets(process: Pid) -> Vec<Socket> {
    let folder = format!("/proc/{}", process.as_raw_nonzero());
    let links =
        fs::read_dir(format!("{folder}/fd")).unwrap().flatten().filter_map(|file| fs::read_link(file.path()).ok());
    let own: Vec<String> = links.map(|link| link.display().to_string()).collect();
    let table = fs::read_to_string(format!("{folder}/net/udp")).unwrap();
    let socket = |line: &str| {
        let fields: Vec<_> = line.split_whitespace().collect();
        let inode = format!("socket:[{}]", fields.get(9)?);
        let port = fields.get(1)?.split_once(':')?.1;
        let is_own = own.contains(&inode);
        is_own.then(|| Socket {
            port: u16::from_str_radix(port, 16).unwrap(),
            dropped: fields.last().unwrap().parse().unwrap(),
        })
    };
    table.lines().skip(1).filter_map(socket).collect()
}

/// The socket with which an agent asks its simulator; an agent has no other one.
fn socket(process: Pid) -> Socket {
    let all = sockets(process);
    let [socket] = all[..] else { panic!("one UDP socket expected: {all:?}") };
    socket
}

/// Numbers of datagrams by what is wrong with them.
#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    malformed: u64,
    foreign: u64,
}

impl Counts {
    fn of(drops: &Drops) -> Self {
        Self { malformed: drops.plant_malformed, foreign: drops.plant_foreign }
    }
}

/// Makes hostile datagrams.
struct Attacker {
    origin: Origin,
    rng: ChaCha8Rng,
    sent: Counts,
}

impl Attacker {
    fn chance(&mut self) -> f64 {
        f64::from(self.rng.next_u32()) / f64::from(u32::MAX)
    }

    /// The next datagram, near a vehicle that is here.
    fn datagram(&mut self, here: &Trace) -> Vec<u8> {
        let kind = self.rng.next_u32() % 8;
        *(if kind < 3 { &mut self.sent.malformed } else { &mut self.sent.foreign }) += 1;
        let mut datagram = Vec::new();
        match kind {
            // Bytes without a tag, none at all, a message cut off, a number that is not finite.
            0 => {
                datagram.resize(self.rng.next_u32() as usize % 256, 0);
                self.rng.fill_bytes(&mut datagram);
                if let Some(first) = datagram.first_mut() {
                    *first |= 0x80;
                }
            }
            1 => {
                self.position(here).encode(&mut datagram);
                datagram.truncate(5 + self.rng.next_u32() as usize % 64);
            }
            2 => {
                let latitude_deg = f64::NAN;
                Position { latitude_deg, ..self.position(here) }.encode(&mut datagram);
            }
            // Positions that the simulator could send.
            3..=5 => self.position(here).encode(&mut datagram),
            // The values of a subscription that counts from 0, as most programs do.
            _ => {
                let place = self.position(here);
                let values =
                    [place.latitude_deg, place.longitude_deg, place.elevation_m, 0.0, 1.0].map(|value| value as f32);
                let numbered: Vec<_> = (0..).zip(values).collect();
                rref::encode_values(&numbered, &mut datagram).unwrap();
            }
        }
        datagram
    }

    /// A position at most 5 m from the true one on each axis, with an attitude and a velocity that call for large controls.
    fn position(&mut self, here: &Trace) -> Position {
        let offset_m = [(); 3].map(|()| 10.0 * self.chance() - 5.0);
        let PositionNed(place) = here.position;
        let at = self.origin.geodetic_from_ned(PositionNed(place + Vector3::from(offset_m)));
        Position {
            longitude_deg: at.longitude_deg(),
            latitude_deg: at.latitude_deg(),
            elevation_m: at.altitude_m,
            height_m: here.height_m as f32,
            roll_deg: 40.0,
            velocity_up_m_s: -5.0,
            yaw_rate_rad_s: 3.0,
            ..Position::default()
        }
    }

    /// Sends datagrams to the port until the stop.
    fn run(mut self, port: u16, here: &Mutex<Trace>, stop: &AtomicBool) -> (Counts, Duration) {
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let period = Duration::from_secs(1) * BURST / RATE_HZ;
        let begin = Instant::now();
        let mut next = begin;
        while !stop.load(Relaxed) {
            let here = here.lock().unwrap().clone();
            for _ in 0..BURST {
                let datagram = self.datagram(&here);
                // The loopback delivers at once: it drops what does not fit into the receiver's queue, and counts that there.
                socket.send_to(&datagram, (Ipv4Addr::LOCALHOST, port)).unwrap();
            }
            next += period;
            thread::sleep(next.saturating_duration_since(Instant::now()));
        }
        (self.sent, begin.elapsed())
    }
}

/// The newest step of each vehicle.
fn steps(observer: &mut Observer) -> Vec<(VehicleId, Trace)> {
    observer.poll();
    let views = observer.vehicles().iter();
    views.filter_map(|(id, view)| Some((*id, view.trace.clone()?))).collect()
}

/// Watches the vehicles for this long.
fn watch(observer: &mut Observer, lasts: Duration, mut look: impl FnMut(&[(VehicleId, Trace)])) {
    let begin = Instant::now();
    while begin.elapsed() < lasts {
        look(&steps(observer));
        thread::sleep(Duration::from_millis(5));
    }
}

/// The largest distance so far of any vehicle from where it was at first, m.
struct Places {
    first: Vec<PositionNed>,
    largest_m: f64,
}

impl Places {
    fn new(steps: &[(VehicleId, Trace)]) -> Self {
        Self { first: steps.iter().map(|(_, step)| step.position).collect(), largest_m: 0.0 }
    }

    fn look(&mut self, steps: &[(VehicleId, Trace)]) {
        let distances = steps.iter().zip(&self.first).map(|((_, step), first)| (step.position - *first).norm());
        self.largest_m = distances.fold(self.largest_m, f64::max);
    }
}

/// The vehicles of a ring in the order of their bearings from its centre.
struct Ring {
    slots: Vec<f64>,
}

impl Ring {
    fn new(steps: &[(VehicleId, Trace)]) -> Self {
        let bearings: Vec<f64> = steps.iter().map(|(_, step)| polar(step).1).collect();
        let rank = |own: &f64| bearings.iter().filter(|other| *other < own).count() as f64;
        Self { slots: bearings.iter().map(|own| rank(own) * TAU / bearings.len() as f64).collect() }
    }

    /// Where each vehicle is in the ring, m: its distance from the centre, the arc from its place in an even ring that turns
    /// with the vehicles, and its altitude.
    fn places(&self, steps: &[(VehicleId, Trace)]) -> Vec<Vector3<f64>> {
        let turned = |(step, slot): (&(VehicleId, Trace), &f64)| polar(&step.1).1 - slot;
        let turned: Vec<f64> = steps.iter().zip(&self.slots).map(turned).collect();
        let (sin, cos) = turned.iter().fold((0.0, 0.0), |(sin, cos), angle| (sin + angle.sin(), cos + angle.cos()));
        let phase = sin.atan2(cos);
        let places = steps.iter().zip(&turned).map(|((_, step), angle)| {
            let (radius_m, _) = polar(step);
            Vector3::new(radius_m, radius_m * wrap_rad(angle - phase), step.position.altitude_m())
        });
        places.collect()
    }
}

/// Distance, m, and bearing, rad, of a vehicle from the centre of its ring.
fn polar(step: &Trace) -> (f64, f64) {
    let [north_m, east_m] = step.centre_ne_m;
    let (north_m, east_m) = (step.position.north_m() - north_m, step.position.east_m() - east_m);
    (north_m.hypot(east_m), east_m.atan2(north_m))
}

/// Largest deviation of a gap of the ring from an even one, degrees.
fn gap_deg(steps: &[(VehicleId, Trace)]) -> f64 {
    let mut bearings: Vec<f64> = steps.iter().map(|(_, step)| polar(step).1).collect();
    largest_gap_deviation_rad(&mut bearings).map_or(f64::INFINITY, f64::to_degrees)
}

/// Largest distance of any vehicle from its track, m: by radius, arc and altitude, and all together.
fn off_track_m(all: &[Vec<Vector3<f64>>], tracks: &[Vector3<f64>]) -> [f64; 4] {
    let off = all.iter().flat_map(|places| places.iter().zip(tracks).map(|(place, track)| place - track));
    off.fold([0.0; 4], |largest: [f64; 4], off| {
        let off = [off.x.abs(), off.y.abs(), off.z.abs(), off.norm()];
        std::array::from_fn(|nth| largest[nth].max(off[nth]))
    })
}

/// Attacks vehicle 1 for so long, and meanwhile shows every step to `look`.
fn attack(flight: &Flight, observer: &mut Observer, lasts: Duration, mut look: impl FnMut(&[(VehicleId, Trace)])) {
    let victim = VehicleId::new(1).unwrap();
    let process = flight.agent(1);
    let socket_before = socket(process);
    let health = |observer: &mut Observer| {
        observer.poll();
        observer.health_of(victim).map(|(health, _)| health.clone())
    };
    let health_before = wait_for(|| health(observer));
    let Scenario { origin, .. } = skein_tests::scenario("hover.toml", &[]);
    let attacker =
        Attacker { origin: Origin::new(origin.geodetic()), rng: ChaCha8Rng::seed_from_u64(1), sent: Counts::default() };
    let here = Mutex::new(steps(observer).swap_remove(0).1);
    let stop = AtomicBool::new(false);
    let (sent, took) = thread::scope(|scope| {
        scopeguard::defer! { stop.store(true, Relaxed) }
        let attack = scope.spawn(|| attacker.run(socket_before.port, &here, &stop));
        watch(observer, lasts, |steps| {
            steps.iter().filter(|(id, _)| *id == victim).for_each(|(_, step)| here.lock().unwrap().clone_from(step));
            look(steps);
        });
        stop.store(true, Relaxed);
        attack.join().unwrap()
    });
    thread::sleep(COUNTED_AFTER);
    let health_after = health(observer).unwrap();
    let (before, after) = (Counts::of(&health_before.drops), Counts::of(&health_after.drops));
    let counted = Counts { malformed: after.malformed - before.malformed, foreign: after.foreign - before.foreign };
    let lost = socket(process).dropped - socket_before.dropped;
    let all = sent.malformed + sent.foreign;
    let rate_hz = all as f64 / took.as_secs_f64();
    println!(
        "{rate_hz:.0} datagrams a second for {:.1} s: {sent:?}, {counted:?}, {lost} lost in the queue; \
         frame rate {:.1} Hz before, {:.1} Hz after; late steps {}",
        took.as_secs_f64(),
        health_before.frame_rate_hz,
        health_after.frame_rate_hz,
        health_after.frame_overruns - health_before.frame_overruns,
    );
    assert!(rate_hz >= LEAST_SHARE * f64::from(RATE_HZ), "the attack is too weak: {rate_hz:.0} a second");
    assert!(counted.malformed <= sent.malformed && counted.foreign <= sent.foreign, "the simulator's own were refused");
    assert!(counted.malformed + counted.foreign + lost >= all, "datagrams that were not counted");
}

#[test]
fn ten_seconds_of_hostile_datagrams_move_no_vehicle_and_are_counted_by_kind() {
    let _share = Share::of(100);
    let lasts = Duration::from_secs(10);
    let flight = Flight::start("hostile", &["--plant", "standin"]);
    drop(flight.wait_until_all(Activity::Formation));
    let hold = command(flight.folder.path()).args(["order", "hold"]).output().unwrap();
    assert!(hold.status.success(), "{}", String::from_utf8_lossy(&hold.stderr));
    let mut observer = flight.wait_until_all(Activity::Holding);
    wait_for(|| {
        let all = steps(&mut observer);
        (all.len() == 3 && all.iter().all(|(_, step)| step.velocity.0.norm() < STANDING_M_S)).then_some(())
    });
    let mut before = Places::new(&steps(&mut observer));
    watch(&mut observer, lasts, |steps| before.look(steps));
    let mut under_attack = Places::new(&steps(&mut observer));
    attack(&flight, &mut observer, lasts, |steps| under_attack.look(steps));
    println!("from their places {:.2} m before, {:.2} m under attack", before.largest_m, under_attack.largest_m);
    assert!(under_attack.largest_m <= STAYS_WITHIN_M, "{} m, {} m before", under_attack.largest_m, before.largest_m);
}

#[test]
#[ignore = "flies for minutes: `.ci/long`"]
fn a_minute_of_hostile_datagrams_moves_no_vehicle_of_a_ring_off_its_track_and_is_counted_by_kind() {
    let _share = Share::of(100);
    let flight = Flight::of("hostile-ring", 4, &["--plant", "standin"]);
    let mut observer = flight.wait_until_all(Activity::Formation);
    let begin = Instant::now();
    let (ring, tracks, before_m) = loop {
        assert!(begin.elapsed() < STEADY_WITHIN, "the ring is not steady: {} deg", gap_deg(&steps(&mut observer)));
        if steps(&mut observer).len() < 4 || gap_deg(&steps(&mut observer)) > EVEN_DEG {
            thread::sleep(Duration::from_millis(100));
            continue;
        }
        let ring = Ring::new(&steps(&mut observer));
        let mut places = Vec::new();
        watch(&mut observer, MEASURED, |steps| places.push(ring.places(steps)));
        let track = |nth: usize| places.iter().map(|places| places[nth]).sum::<Vector3<f64>>() / places.len() as f64;
        let tracks: Vec<Vector3<f64>> = (0..4).map(track).collect();
        let off_m = off_track_m(&places, &tracks);
        if off_m[3] < STEADY_M {
            break (ring, tracks, off_m);
        }
    };
    let mut places = Vec::new();
    attack(&flight, &mut observer, Duration::from_secs(60), |steps| places.push(ring.places(steps)));
    let under_attack_m = off_track_m(&places, &tracks);
    println!("off the track, radius, arc, altitude, all, m: {before_m:.3?} before, {under_attack_m:.3?} under attack");
    assert!(under_attack_m[3] <= STAYS_WITHIN_M, "{under_attack_m:?} m, {before_m:?} m before");
}
