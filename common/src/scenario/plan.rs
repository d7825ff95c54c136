//! Hash by which agents check that they fly the same plan.

use toml::Value as Toml;

use super::model::Scenario;
use crate::hash::{FNV_1A_START, fnv_1a};

impl Scenario {
    /// 64-bit FNV-1a hash of the values on which the swarm has to agree: number of vehicles, origin, formation, steps
    /// and partition rule of the mission, and the airspace. It does not depend on the spelling of the file, on events, or on how a host
    /// starts the program of an external law. Tables are hashed with sorted names and numbers by their bits, so that
    /// the hash is the same on every platform.
    pub fn plan_hash(&self) -> u64 {
        let mut plan = toml::Table::new();
        let mut put = |name: &str, part: Result<Toml, toml::ser::Error>| {
            // The parts are numbers, texts, lists and structs of them: TOML can represent all of them.
            plan.insert(name.to_owned(), part.expect("TOML can represent every plan"));
        };
        put("vehicles", Toml::try_from(self.swarm.vehicles));
        put("origin", Toml::try_from(self.origin));
        put("formation", Toml::try_from(&self.formation));
        put("steps", Toml::try_from(&self.mission.steps));
        put("partition", Toml::try_from(self.mission.partition));
        if !self.airspace.is_unlimited() {
            put("airspace", Toml::try_from(&self.airspace));
        }
        let mut plan = Toml::Table(plan);
        remove_programs(&mut plan);
        hash(&plan, FNV_1A_START)
    }
}

/// Removes the keys that start and reach the program of an external law from every formation.
fn remove_programs(value: &mut Toml) {
    match value {
        Toml::Table(table) => {
            if let Some(Toml::Table(external)) = table.get_mut("external") {
                for name in ["command", "listen", "udp", "deadline_s"] {
                    external.remove(name);
                }
            }
            table.iter_mut().for_each(|(_, inner)| remove_programs(inner));
        }
        Toml::Array(items) => items.iter_mut().for_each(remove_programs),
        _ => {}
    }
}

/// FNV-1a, continued from `state`, over a letter for the kind, the length where it varies, and the
/// content.
fn hash(value: &Toml, state: u64) -> u64 {
    match value {
        Toml::String(text) => fnv_1a(text.as_bytes(), length(b's', text.len(), state)),
        Toml::Integer(number) => fnv_1a(&number.to_le_bytes(), fnv_1a(b"i", state)),
        Toml::Float(number) => fnv_1a(&number.to_bits().to_le_bytes(), fnv_1a(b"f", state)),
        Toml::Boolean(truth) => fnv_1a(&[b'b', u8::from(*truth)], state),
        Toml::Datetime(date) => fnv_1a(date.to_string().as_bytes(), fnv_1a(b"d", state)),
        Toml::Array(items) => items.iter().fold(length(b'a', items.len(), state), |state, item| hash(item, state)),
        Toml::Table(table) => {
            let mut entries: Vec<_> = table.iter().collect();
            entries.sort_by_key(|(name, _)| *name);
            entries.iter().fold(length(b't', table.len(), state), |state, (name, inner)| {
                hash(inner, fnv_1a(name.as_bytes(), length(b'n', name.len(), state)))
            })
        }
    }
}

fn length(kind: u8, length: usize, state: u64) -> u64 {
    fnv_1a(&(length as u64).to_le_bytes(), fnv_1a(&[kind], state))
}
