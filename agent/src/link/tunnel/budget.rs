//! Limits what one network or one certificate can take of a listening agent, so that an attacker or a stolen key leaves
//! enough for the other hosts: handshakes that are pending, handshakes in a second, links, and what a guest sends and gets.

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

use parking_lot::Mutex;

/// Handshakes a second that one network may begin on average, and at once. A handshake costs about a millisecond of one
/// core. Several agents may share a host, and each of them dials at the start; a refused one dials again.
const HANDSHAKES_PER_S: f64 = 32.0;
const HANDSHAKES_AT_ONCE: f64 = 64.0;
/// The same limits for all networks together.
const ALL_HANDSHAKES_PER_S: f64 = 200.0;
const ALL_HANDSHAKES_AT_ONCE: f64 = 256.0;
/// Largest number of networks whose rate is remembered.
const MAX_NETWORKS: usize = 4096;

/// Bytes a second that all links of one guest's certificate may send together on average, and at once. An observer sends its
/// subscriptions of 20 bytes, a few bytes a second to keep the link, and orders of 300 bytes.
const FROM_GUEST_BYTES_PER_S: f64 = 2_048.0;
const FROM_GUEST_BYTES_AT_ONCE: f64 = 16_384.0;
/// Bytes that a guest may send in one link. Zenoh remembers each declaration of a link until the link ends, in many times
/// its length. An observer has a new link within a second.
const FROM_GUEST_BYTES: u64 = 65_536;
/// Bytes a second that the feed sends on one link on average, and at once: many times the traces of one vehicle. What is too much
/// for a link, Zenoh drops.
const TO_GUEST_BYTES_PER_S: f64 = 524_288.0;
const TO_GUEST_BYTES_AT_ONCE: f64 = 524_288.0;

/// The network of an address, as far as one host may choose its address freely: an IPv4 address, or a /64 of IPv6.
pub(super) fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V4(address) => address.into(),
        IpAddr::V6(address) => {
            let [a, b, c, d, ..] = address.segments();
            Ipv6Addr::new(a, b, c, d, 0, 0, 0, 0).into()
        }
    }
}

/// Counts what is in use, by key.
pub(super) struct Quota<K>(Mutex<BTreeMap<K, usize>>);

/// One use, which ends when this is dropped.
pub(super) struct QuotaUse<K: Ord + Clone> {
    quota: Arc<Quota<K>>,
    key: K,
}

impl<K: Ord + Clone> Quota<K> {
    pub(super) fn new() -> Arc<Self> {
        Arc::new(Self(Mutex::default()))
    }

    /// Takes one use for this key. Returns `None` if the key has `most` already, or all keys together have `most_of_all`.
    pub(super) fn take(self: &Arc<Self>, key: K, most: usize, most_of_all: usize) -> Option<QuotaUse<K>> {
        let mut counts = self.0.lock();
        if counts.values().sum::<usize>() >= most_of_all || counts.get(&key).is_some_and(|count| *count >= most) {
            return None;
        }
        *counts.entry(key.clone()).or_default() += 1;
        Some(QuotaUse { quota: self.clone(), key })
    }
}

impl<K: Ord + Clone> Drop for QuotaUse<K> {
    fn drop(&mut self) {
        let mut counts = self.quota.0.lock();
        counts.entry(self.key.clone()).and_modify(|count| *count -= 1);
        counts.retain(|_, count| *count > 0);
    }
}

/// Limits the rate of handshakes of each network and of all networks together.
pub(super) struct HandshakeRate {
    of_network: BTreeMap<IpAddr, TokenBucket>,
    of_all: TokenBucket,
}

impl HandshakeRate {
    pub(super) fn new(now: Instant) -> Self {
        let of_all = TokenBucket::full(ALL_HANDSHAKES_PER_S, ALL_HANDSHAKES_AT_ONCE, now);
        Self { of_network: BTreeMap::new(), of_all }
    }

    /// Whether a host of this network may begin a handshake now.
    pub(super) fn allows(&mut self, network: IpAddr, now: Instant) -> bool {
        if self.of_network.len() >= MAX_NETWORKS && !self.of_network.contains_key(&network) {
            // A full bucket is that of a network that was never seen.
            self.of_network.retain(|_, bucket| bucket.fill(now) < HANDSHAKES_AT_ONCE);
            if self.of_network.len() >= MAX_NETWORKS {
                return false;
            }
        }
        let full = TokenBucket::full(HANDSHAKES_PER_S, HANDSHAKES_AT_ONCE, now);
        let own = self.of_network.entry(network).or_insert(full);
        let has_own = own.fill(now) >= 1.0;
        // A network above its own limit takes nothing from the others.
        if has_own && self.of_all.fill(now) >= 1.0 {
            own.tokens -= 1.0;
            self.of_all.tokens -= 1.0;
            return true;
        }
        false
    }
}

/// A token bucket: it fills at a constant rate up to its size.
struct TokenBucket {
    per_s: f64,
    size: f64,
    tokens: f64,
    at: Instant,
}

impl TokenBucket {
    fn full(per_s: f64, size: f64, now: Instant) -> Self {
        Self { per_s, size, tokens: size, at: now }
    }

    /// Adds the tokens since the last call, and returns how many there are.
    fn fill(&mut self, now: Instant) -> f64 {
        let since = now.saturating_duration_since(self.at);
        self.at = now;
        self.tokens = (self.tokens + since.as_secs_f64() * self.per_s).min(self.size);
        self.tokens
    }
}

/// The rate at which each guest, an observer or operator, may still send now, by the name in its certificate.
#[derive(Default)]
pub(super) struct GuestRates(Mutex<BTreeMap<String, Weak<Mutex<TokenBucket>>>>);

impl GuestRates {
    /// Begins a link of this guest: the limits of what it sends and of what it gets.
    pub(super) fn link(&self, name: &str, now: Instant) -> (ByteLimit, ByteLimit) {
        let mut rates = self.0.lock();
        rates.retain(|_, rate| rate.strong_count() > 0);
        let of_guest = rates.get(name).and_then(Weak::upgrade).unwrap_or_else(|| {
            let full = TokenBucket::full(FROM_GUEST_BYTES_PER_S, FROM_GUEST_BYTES_AT_ONCE, now);
            let of_guest = Arc::new(Mutex::new(full));
            rates.insert(name.to_owned(), Arc::downgrade(&of_guest));
            of_guest
        });
        let sent = TokenBucket::full(TO_GUEST_BYTES_PER_S, TO_GUEST_BYTES_AT_ONCE, now);
        let received = ByteLimit { rate: of_guest, left: FROM_GUEST_BYTES };
        (received, ByteLimit { rate: Arc::new(Mutex::new(sent)), left: u64::MAX })
    }
}

/// Limits one direction of a link.
pub(super) struct ByteLimit {
    /// Shared by all links of a guest for what it sends: one that has more links keeps its rate until the last of them ends.
    rate: Arc<Mutex<TokenBucket>>,
    left: u64,
}

impl ByteLimit {
    /// Accounts for bytes that have been read. Returns the time to wait before they are passed on, or `None` if the link
    /// has to end.
    pub(super) fn take(&mut self, bytes: usize, now: Instant) -> Option<Duration> {
        self.left = self.left.checked_sub(bytes as u64)?;
        let mut rate = self.rate.lock();
        // A token for each byte, also those that come later: the time to wait is that until they have come.
        rate.tokens = rate.fill(now) - bytes as f64;
        Some(Duration::from_secs_f64((-rate.tokens / rate.per_s).max(0.0)))
    }
}

#[cfg(test)]
mod tests {
    use skein_host::clock::now;

    use super::*;

    fn ip(text: &str) -> IpAddr {
        text.parse().unwrap()
    }

    #[test]
    fn one_key_cannot_use_the_whole_quota() {
        let quota = Quota::new();
        let mut taken: Vec<_> = (0..9).filter_map(|_| quota.take(ip("10.0.0.9"), 4, 6)).collect();
        assert_eq!(taken.len(), 4);
        let others: Vec<_> = (0..9).filter_map(|_| quota.take(ip("10.0.0.11"), 4, 6)).collect();
        assert_eq!(others.len(), 2, "six for all keys together");
        taken.pop();
        assert!(quota.take(ip("10.0.0.9"), 4, 6).is_some(), "one of its uses has ended");
        drop((taken, others));
        assert!(quota.0.lock().is_empty(), "a key without uses is forgotten");
    }

    #[test]
    fn addresses_of_one_ipv6_subnet_are_one_network() {
        assert_eq!(network(ip("2001:db8::1")), network(ip("2001:db8::ffff:1")));
        assert_ne!(network(ip("2001:db8::1")), network(ip("2001:db8:0:1::1")));
        assert_ne!(network(ip("10.0.0.1")), network(ip("10.0.0.2")));
        assert_eq!(network(ip("::ffff:10.0.0.1")), ip("10.0.0.1"), "an IPv4 address in IPv6 form");
    }

    /// One second of seven thousand connections from one network, and one of another host in the middle.
    #[test]
    fn a_flood_of_handshakes_leaves_room_for_another_host() {
        let begin = now();
        let mut rate = HandshakeRate::new(begin);
        let at = |nth: u32| begin + Duration::from_secs(1) * nth / 7000;
        let mut allowed = 0;
        for nth in 0..7000 {
            allowed += u32::from(rate.allows(ip("10.0.0.9"), at(nth)));
            assert!(nth != 3500 || rate.allows(ip("10.0.0.11"), at(nth)), "the other host");
        }
        assert!((90..=97).contains(&allowed), "{allowed} of one network: 64 at once and 32 in a second");
        // A flood from very many networks is limited as a whole, in handshakes and in memory.
        let many = (0..20_000_u32).filter(|nth| rate.allows(IpAddr::from((0x0a01_0000 + nth).to_be_bytes()), at(7000)));
        assert!(many.count() <= ALL_HANDSHAKES_AT_ONCE as usize);
        assert!(rate.of_network.len() <= MAX_NETWORKS);
        let later = at(7000) + Duration::from_secs(3);
        assert!(rate.allows(ip("10.9.9.9"), later), "three seconds later the memory is free again");
    }
    #[test]
    fn all_links_of_a_guest_share_a_rate_and_each_may_send_only_so_much() {
        let (rates, begin) = (GuestRates::default(), now());
        let (mut first, mut second) = (rates.link("observer", begin), rates.link("observer", begin));
        assert_eq!(first.0.take(FROM_GUEST_BYTES_AT_ONCE as usize, begin), Some(Duration::ZERO));
        let wait = second.0.take(FROM_GUEST_BYTES_PER_S as usize, begin);
        assert_eq!(wait, Some(Duration::from_secs(1)), "the first link has used the rate");
        assert_eq!(rates.link("operator", begin).0.take(300, begin), Some(Duration::ZERO), "another guest");
        let later = begin + Duration::from_secs(3600);
        let mut read = 0;
        while first.0.take(1024, later + Duration::from_secs(read)).is_some() {
            read += 1;
        }
        assert_eq!(read * 1024, FROM_GUEST_BYTES - FROM_GUEST_BYTES_AT_ONCE as u64);
        drop((first, second));
        drop(rates.link("operator", later));
        assert!(rates.0.lock().keys().eq(["operator"]), "a guest without links is forgotten");
    }

    #[test]
    fn a_link_sends_a_guest_no_more_than_its_rate() {
        let (rates, begin) = (GuestRates::default(), now());
        let mut sent = rates.link("observer", begin).1;
        let mut at = begin;
        for _ in 0..2048 {
            at += sent.take(1024, at).unwrap();
        }
        let lasts_s = (at - begin).as_secs_f64();
        assert!(
            (2.9..3.1).contains(&lasts_s),
            "two megabytes in {lasts_s} s: half a megabyte at once, then as much a second"
        );
    }
}
