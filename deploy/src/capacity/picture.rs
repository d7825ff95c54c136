//! Draws the load over the size of the fleet, one line for each communication scheme.

use super::fleet::{Load, Scheme};
use super::{GIGABIT_S, LARGEST_FLEET};
use skein_cluster::capacity::Measured;
use skein_lab::report::figure::{Axis, Colour, Drawing, Item, Panel, WIDTH_PX};

/// The quantity of a load that a panel shows, if it is known.
type Quantity = fn(&Load) -> Option<f64>;

/// The figure, with three panels: the busiest port, the busiest computer's cores, the whole network.
pub(super) fn figure(measured: &Measured) -> Drawing {
    let port: Quantity = |load| Some(load.port_bit_s[0].max(load.port_bit_s[1]) / 1e6);
    let network: Quantity = |load| Some(load.network_bit_s / 1e6);
    let cores: Quantity = |load| load.cores;
    let limit_mbit_s = GIGABIT_S / 1e6;
    let panels = [
        ("the busiest computer's port, the busier direction", Axis::new("traffic", "Mbit/s"), port, limit_mbit_s),
        ("the busiest computer's processor", Axis::new("cores", "1"), cores, 1.0),
        ("the whole network", Axis::new("traffic", "Mbit/s"), network, limit_mbit_s),
    ];
    let count = panels.len() as f64;
    let panels = panels.into_iter().enumerate().map(|(nth, (title, y, quantity, limit))| Panel {
        place: [0.0, nth as f64 / count, 0.97, (nth as f64 + 1.0) / count],
        title: title.to_owned(),
        items: items(measured, quantity, limit, nth == 0),
        ..Panel::new(Axis::new("vehicles", "1").log(), y.log())
    });
    Drawing {
        name: "capacity".to_owned(),
        title: "Load of a fleet on its network and on its busiest computer".to_owned(),
        subject: format!("{}, {}", measured.machine, measured.when),
        caption: "Broken lines are schemes with a central controller, full lines are without. The grey line is the limit: 1 Gbit/s or \
                  one core."
            .to_owned(),
        size_px: [WIDTH_PX, 1000.0],
        panels: panels.collect(),
    }
}

fn items(measured: &Measured, quantity: Quantity, limit: f64, named: bool) -> Vec<Item> {
    let fleets: Vec<u32> = std::iter::successors(Some(2_u32), |fleet| Some(fleet + fleet.div_ceil(4)))
        .take_while(|fleet| *fleet < LARGEST_FLEET)
        .chain([LARGEST_FLEET])
        .collect();
    let schemes = Scheme::all(measured);
    let mut items =
        vec![Item::line(vec![vec![[2.0, limit], [f64::from(LARGEST_FLEET), limit]]], Colour::GREY).wide(1.0)];
    for (nth, scheme) in schemes.iter().enumerate() {
        let point = |fleet: &u32| Some([f64::from(*fleet), quantity(&scheme.load(measured, *fleet))?]);
        let line = Item::line(vec![fleets.iter().filter_map(point).collect()], Colour::nth(nth)).marked(nth);
        let line = if scheme.is_central() { line.dashed() } else { line };
        items.push(if named { line.in_legend(scheme.name) } else { line });
    }
    items
}
