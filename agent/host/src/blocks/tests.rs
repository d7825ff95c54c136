use skein_common::frame::{Geodetic, Origin};
use skein_common::id::VehicleId;
use skein_common::math;
use skein_core::aircraft::Aircraft;
use skein_core::helicopter::{Failures, Start, Weather};

use super::*;

/// [`compute`] on a processor without AVX-512.
#[multiversion(targets("x86_64+avx2"))]
fn compute_without_avx512(block: &mut Block) {
    block.compute();
}

/// [`compute`] on a processor without AVX2.
fn compute_with_baseline(block: &mut Block) {
    block.compute();
}

fn vehicles(count: u8) -> Vec<BuiltInVehicle> {
    let origin = Origin::new(Geodetic::from_degrees(28.0, -82.0, 10.0));
    let aircraft = Aircraft::shipped("xcell60").unwrap().unwrap();
    let gusty = Weather { wind_m_s: 5.0, wind_from_rad: 0.5, gust_w20_m_s: 10.0 };
    VehicleId::first(usize::from(count))
        .map(|id| {
            let start = Start { heading_rad: f64::from(id.get()), ..Start::default() };
            BuiltInVehicle::new(&origin, aircraft.helicopter.as_ref().unwrap(), &start, &gusty, 3, id)
        })
        .collect()
}

/// Every vehicle takes off, climbs and, one after the other, loses its engine and falls to the ground.
fn controls(tick: usize, nth: usize, vehicle: &mut BuiltInVehicle) -> Option<Controls> {
    let engine_out = tick > 300 + 40 * nth;
    vehicle.fail(Failures { engine_out, ..Failures::default() });
    let (swing, _) = math::sin_cos(0.05 * (tick + 30 * nth) as f64);
    let flies = Controls { roll: 0.1 * swing, pitch: 0.1 * swing, yaw: swing, collective: 0.65 };
    (tick >= 10 * nth).then_some(flies)
}

fn flown(count: u8, mut advance: impl FnMut(&mut [BuiltInVehicle], &[Option<Controls>])) -> Vec<String> {
    let mut vehicles = vehicles(count);
    for tick in 0..1_000 {
        let controls: Vec<_> =
            vehicles.iter_mut().enumerate().map(|(nth, vehicle)| controls(tick, nth, vehicle)).collect();
        advance(&mut vehicles, &controls);
    }
    vehicles.iter().map(|vehicle| format!("{:?}", vehicle.frame())).collect()
}

fn alone(vehicles: &mut [BuiltInVehicle], controls: &[Option<Controls>]) {
    vehicles.iter_mut().zip(controls).for_each(|(vehicle, controls)| vehicle.advance(*controls));
}

#[test]
fn every_kind_of_processor_computes_the_same_bits() {
    let expected = flown(8, alone);
    assert!(!expected.iter().any(|frame| frame.contains("NaN")), "{expected:?}");
    for compute in [compute, compute_without_avx512, compute_with_baseline] {
        let mut block = Block::default();
        let together = flown(8, |vehicles, controls| {
            block.advance(vehicles.iter_mut().zip(controls.iter().copied()), compute);
        });
        assert_eq!(together, expected);
    }
}

#[test]
fn any_number_of_vehicles_flies_as_each_alone() {
    for count in [1, 7, 8, 9, 20] {
        let mut blocks = Blocks::default();
        let together = flown(count, |vehicles, controls| {
            blocks.advance(vehicles.iter_mut().zip(controls.iter().copied()));
        });
        assert_eq!(together, flown(count, alone), "{count} vehicles");
    }
}

#[test]
fn blocks_with_few_empty_lanes_are_full() {
    let full: Vec<usize> = (0..=24).filter(|vehicles| Blocks::are_full(*vehicles)).collect();
    assert_eq!(full, [7, 8, 14, 15, 16, 21, 22, 23, 24]);
    assert!((25..1_000).filter(|vehicles| vehicles % 8 >= 4).all(Blocks::are_full));
}
