//! The orders in force, merged without a leader.

use super::{Order, Verb};
use crate::id::{VehicleId, VehicleSet};
use crate::scenario::Setting;

/// The orders in force, as one agent or observer knows them: a register for the whole swarm, one for each vehicle
/// that an order has named, and one for each key that an order has set. Every register keeps the largest order that it
/// was given. Agents that have received the same orders therefore have the same registers, whatever the order, number
/// and delay of the messages.
///
/// A vehicle obeys the larger of the swarm's order and its own. There is one exception: a vehicle that an order has
/// released to a human pilot obeys only later orders that name it, so that an order to the swarm never takes the controls
/// out of a pilot's hands.
///
/// An order that names several vehicles is kept once, while it is the largest one of any of them: there are at most
/// as many orders as vehicles, one more, and one for each key that can change in flight.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StandingOrders {
    swarm: Option<Order>,
    /// The orders that name vehicles, from the largest to the smallest.
    named: Vec<Order>,
    /// The orders that set keys, by key.
    settings: Vec<(Setting, Order)>,
}

impl StandingOrders {
    /// Takes an order; returns whether it changes a register.
    pub fn merge(&mut self, order: Order) -> bool {
        if let Verb::Set(setting) = order.verb {
            return self.merge_setting(setting, order);
        }
        let Some(vehicles) = order.vehicles else {
            let is_newer = self.swarm < Some(order);
            self.swarm = self.swarm.max(Some(order));
            return is_newer;
        };
        let place = self.named.partition_point(|known| *known >= order);
        if vehicles.without(named_by(&self.named[..place])).is_empty() {
            return false;
        }
        self.named.insert(place, order);
        let mut above = VehicleSet::default();
        self.named.retain(|known| {
            let vehicles = known.vehicles.unwrap_or_default();
            let is_largest_of_one = !vehicles.without(above).is_empty();
            above.extend(vehicles);
            is_largest_of_one
        });
        true
    }

    fn merge_setting(&mut self, setting: Setting, order: Order) -> bool {
        match self.settings.binary_search_by_key(&setting.key, |(known, _)| known.key) {
            Ok(place) if self.settings[place].1 >= order => return false,
            Ok(place) => self.settings[place] = (setting, order),
            Err(place) => self.settings.insert(place, (setting, order)),
        }
        true
    }

    /// The settings in force with their orders, by key.
    pub fn settings(&self) -> &[(Setting, Order)] {
        &self.settings
    }

    /// The settings in force in the sequence in which they were ordered.
    pub fn settings_in_sequence(&self) -> Vec<Setting> {
        let mut all = self.settings.clone();
        all.sort_by_key(|(_, order)| *order);
        all.into_iter().map(|(setting, _)| setting).collect()
    }

    /// The largest order that names this vehicle.
    pub fn naming(&self, id: VehicleId) -> Option<Order> {
        self.named.iter().find(|order| order.is_to(id)).copied()
    }

    /// The order that this vehicle obeys.
    pub fn obeyed_by(&self, id: VehicleId) -> Option<Order> {
        let own = self.naming(id);
        if own.is_some_and(|own| own.verb == Verb::Release) { own } else { own.max(self.swarm) }
    }

    /// Whether every vehicle that this order is to knows of it or of a larger one.
    pub fn contain(&self, order: &Order) -> bool {
        !self.clone().merge(*order)
    }

    /// The order to the whole swarm.
    pub fn to_swarm(&self) -> Option<Order> {
        self.swarm
    }

    /// All orders: the swarm's first, then those that name vehicles, from the largest to the smallest, then the settings by key.
    pub fn iter(&self) -> impl Iterator<Item = Order> {
        let settings = self.settings.iter().map(|(_, order)| *order);
        self.swarm.into_iter().chain(self.named.iter().copied()).chain(settings)
    }

    /// Number of orders.
    pub fn len(&self) -> usize {
        self.named.len() + usize::from(self.swarm.is_some()) + self.settings.len()
    }

    /// Whether no order is in force.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl FromIterator<Order> for StandingOrders {
    fn from_iter<I: IntoIterator<Item = Order>>(orders: I) -> Self {
        orders.into_iter().fold(Self::default(), |mut all, order| {
            all.merge(order);
            all
        })
    }
}

/// All vehicles that these orders name.
fn named_by(orders: &[Order]) -> VehicleSet {
    orders.iter().fold(VehicleSet::default(), |all, order| all.either(order.vehicles.unwrap_or_default()))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::scenario::TunableKey;

    fn id(number: u8) -> VehicleId {
        VehicleId::new(number).unwrap()
    }

    fn order(epoch: u64, verb: Verb, vehicles: &[u8]) -> Order {
        let vehicles = (!vehicles.is_empty()).then(|| vehicles.iter().copied().map(id).collect());
        Order { epoch, issuer: 1, verb, vehicles, signature: None }
    }

    fn verb_of(orders: &StandingOrders, number: u8) -> Option<Verb> {
        orders.obeyed_by(id(number)).map(|order| order.verb)
    }

    #[test]
    fn orders_to_different_vehicles_stand_beside_each_other() {
        let all = [order(1, Verb::Land, &[1]), order(2, Verb::Hold, &[2, 3]), order(3, Verb::Goto(0), &[3])];
        let mut orders: StandingOrders = all.into_iter().collect();
        let verbs = |orders: &StandingOrders| [1, 2, 3, 4].map(|number| verb_of(orders, number));
        assert_eq!(verbs(&orders), [Some(Verb::Land), Some(Verb::Hold), Some(Verb::Goto(0)), None]);
        assert!(orders.merge(order(4, Verb::Hold, &[])), "to the whole swarm");
        assert_eq!(verbs(&orders), [Some(Verb::Hold); 4]);
        assert!(!orders.merge(order(2, Verb::Land, &[])) && orders.contain(&all[0]));
        assert_eq!((orders.len(), orders.to_swarm()), (4, Some(order(4, Verb::Hold, &[]))));
    }

    #[test]
    fn only_an_order_that_names_a_released_vehicle_takes_its_controls_back() {
        let release = order(1, Verb::Release, &[3]);
        let mut orders: StandingOrders =
            [release, order(2, Verb::Hold, &[]), order(1, Verb::Abort, &[])].into_iter().collect();
        assert_eq!((verb_of(&orders, 3), verb_of(&orders, 1)), (Some(Verb::Release), Some(Verb::Abort)));
        orders.merge(order(3, Verb::Goto(0), &[3]));
        assert_eq!(verb_of(&orders, 3), Some(Verb::Abort), "the abort of the swarm applies again");
        let mut orders: StandingOrders =
            [order(3, Verb::Goto(0), &[3]), order(4, Verb::Hold, &[])].into_iter().collect();
        orders.merge(release);
        assert_eq!(verb_of(&orders, 3), Some(Verb::Hold), "a release that arrives late changes nothing");
    }

    #[test]
    fn an_abort_that_names_a_vehicle_is_final() {
        let orders: StandingOrders =
            [order(9, Verb::Release, &[2]), order(1, Verb::Abort, &[2]), order(10, Verb::Goto(0), &[])]
                .into_iter()
                .collect();
        assert_eq!((verb_of(&orders, 2), verb_of(&orders, 1)), (Some(Verb::Abort), Some(Verb::Goto(0))));
    }

    const VERBS: &[Verb] = &[Verb::Hold, Verb::Land, Verb::Goto(0), Verb::Goto(4), Verb::Abort, Verb::Release];

    fn any_order() -> impl Strategy<Value = Order> {
        let vehicles = proptest::collection::vec(1..6_u8, 0..4);
        (0..6_u64, 0..3_u64, proptest::sample::select(VERBS), vehicles)
            .prop_map(|(epoch, issuer, verb, vehicles)| Order { issuer, ..order(epoch, verb, &vehicles) })
    }

    fn any_setting() -> impl Strategy<Value = Order> {
        (0..6_u64, 0..3_u64, proptest::sample::select(TunableKey::ALL), 1..9_u8).prop_map(
            |(epoch, issuer, key, value)| Order {
                issuer,
                ..order(epoch, Verb::Set(Setting { key, value: value.into() }), &[])
            },
        )
    }

    #[test]
    fn a_setting_is_kept_beside_the_orders_and_the_newest_of_a_key_wins() {
        let set = |epoch, text: &str| order(epoch, Verb::Set(text.parse().unwrap()), &[]);
        let all = [
            set(4, "formation.altitude_m=40"),
            order(2, Verb::Hold, &[]),
            set(3, "formation.radius_m=60"),
            set(1, "formation.radius_m=80"),
        ];
        let mut orders: StandingOrders = all.into_iter().collect();
        assert_eq!(verb_of(&orders, 1), Some(Verb::Hold));
        let settings =
            |orders: &StandingOrders| orders.settings_in_sequence().iter().map(ToString::to_string).collect::<Vec<_>>();
        assert_eq!(settings(&orders), ["formation.radius_m=60", "formation.altitude_m=40"]);
        assert!(orders.contain(&all[3]) && !orders.merge(all[3]) && orders.len() == 3);
        assert!(orders.merge(set(5, "formation.radius_m=90")));
        assert_eq!(settings(&orders), ["formation.altitude_m=40", "formation.radius_m=90"]);
    }

    proptest! {
        #[test]
        fn merging_is_commutative_associative_and_idempotent(
            given in proptest::collection::vec((prop_oneof![any_order(), any_setting()], any::<u64>()), 0..12),
            split in 0..12_usize,
        ) {
            let all: StandingOrders = given.iter().map(|(order, _)| *order).collect();
            let mut shuffled = given.clone();
            shuffled.sort_by_key(|(_, key)| *key);
            let orders = shuffled.iter().map(|(order, _)| *order);
            let again: StandingOrders = orders.clone().chain(orders.clone()).collect();
            prop_assert_eq!(&again, &all, "in any order, each twice");
            // Two agents that have received a part each, and repeat what they have kept.
            let (one, other) = given.split_at(split.min(given.len()));
            let part = |part: &[(Order, u64)]| part.iter().map(|(order, _)| *order).collect::<StandingOrders>();
            let merged: StandingOrders = part(other).iter().chain(part(one).iter()).collect();
            prop_assert_eq!(&merged, &all);
            prop_assert!(given.iter().all(|(order, _)| all.contain(order)));
        }

        #[test]
        fn every_vehicle_obeys_the_largest_of_all_orders_to_it_except_while_it_is_released(
            given in proptest::collection::vec(any_order(), 0..12),
        ) {
            let orders: StandingOrders = given.iter().copied().collect();
            for number in 1..6 {
                let named = given.iter().filter(|order| order.vehicles.is_some() && order.is_to(id(number))).max();
                let swarm = given.iter().filter(|order| order.vehicles.is_none()).max();
                let expected = named.filter(|named| named.verb == Verb::Release).or(named.max(swarm));
                prop_assert_eq!(orders.obeyed_by(id(number)), expected.copied());
            }
            prop_assert!(orders.len() <= 6, "one for each vehicle, and the swarm's");
        }
    }
}
