//! The hash by which agents know that they fly the same plan.

use toml::Value as Toml;

use super::model::Scenario;

impl Scenario {
    /// 64-bit FNV-1a of what the swarm has to agree on: how many fly, the origin, the formation, steps and rules of the
    /// mission. Neither bytes of the file nor its events count, nor how a machine starts its external program. Tables
    /// are hashed with sorted names, numbers by their bits: the same on every platform.
    pub fn plan_hash(&self) -> u64 {
        let mut plan = toml::Table::new();
        let mut put = |name: &str, part: Result<Toml, toml::ser::Error>| {
            // Numbers, texts, lists and structs of them: TOML can say all of it.
            plan.insert(name.to_owned(), part.expect("a plan that TOML can say"));
        };
        put("vehicles", Toml::try_from(self.swarm.vehicles));
        put("origin", Toml::try_from(&self.origin));
        put("formation", Toml::try_from(&self.formation));
        put("steps", Toml::try_from(&self.mission.steps));
        put("partition", Toml::try_from(self.mission.partition));
        let mut plan = Toml::Table(plan);
        forget_programs(&mut plan);
        hash(&plan, 0xcbf2_9ce4_8422_2325)
    }
}

/// Removes from every formation how its program is started and reached.
fn forget_programs(value: &mut Toml) {
    match value {
        Toml::Table(table) => {
            if let Some(Toml::Table(external)) = table.get_mut("external") {
                for name in ["command", "listen", "udp", "deadline_s"] {
                    external.remove(name);
                }
            }
            table.iter_mut().for_each(|(_, inner)| forget_programs(inner));
        }
        Toml::Array(items) => items.iter_mut().for_each(forget_programs),
        _ => {}
    }
}

/// FNV-1a (Fowler, Noll, Vo) going on from `state`, over a letter for the kind, a length where it varies, the content.
fn hash(value: &Toml, state: u64) -> u64 {
    match value {
        Toml::String(text) => bytes(text.as_bytes(), length(b's', text.len(), state)),
        Toml::Integer(number) => bytes(&number.to_le_bytes(), bytes(b"i", state)),
        Toml::Float(number) => bytes(&number.to_bits().to_le_bytes(), bytes(b"f", state)),
        Toml::Boolean(truth) => bytes(&[b'b', u8::from(*truth)], state),
        Toml::Datetime(date) => bytes(date.to_string().as_bytes(), bytes(b"d", state)),
        Toml::Array(items) => items.iter().fold(length(b'a', items.len(), state), |state, item| hash(item, state)),
        Toml::Table(table) => {
            let mut entries: Vec<_> = table.iter().collect();
            entries.sort_by_key(|(name, _)| *name);
            entries.iter().fold(length(b't', table.len(), state), |state, (name, inner)| {
                hash(inner, bytes(name.as_bytes(), length(b'n', name.len(), state)))
            })
        }
    }
}

fn length(kind: u8, length: usize, state: u64) -> u64 {
    bytes(&(length as u64).to_le_bytes(), bytes(&[kind], state))
}

fn bytes(bytes: &[u8], state: u64) -> u64 {
    bytes.iter().fold(state, |state, &byte| (state ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Vectors that the authors of FNV publish.
    #[test]
    fn it_is_fnv_1a() {
        let offset = bytes(b"", 0xcbf2_9ce4_8422_2325);
        assert_eq!(bytes(b"a", offset), 0xaf63_dc4c_8601_ec8c);
        assert_eq!(bytes(b"foobar", offset), 0x8594_4171_f739_67e8);
    }
}
