//! Checks of every written key against the table of keys: known, of the right kind, in its range.

use toml::Value as Toml;

use super::error::ScenarioError;
use super::key::{COORDINATES_M, Key, Kind, Range};
use super::keys::{self, Meaning};
use super::law;
use super::tree::{Node, Texts, Value, shown};
use crate::id::{SwarmName, TeamId, VehicleId};

impl Texts<'_> {
    /// Checks a table and all tables below it, and converts integers to floats where the key takes numbers.
    pub(super) fn check_table(&self, node: &mut Node, path: &str) -> Result<(), ScenarioError> {
        let Value::Table(table) = &mut node.value else {
            return Err(self.wrong(node, path, "a table"));
        };
        for (name, (name_place, value)) in table {
            let path = keys::join(path, name);
            match keys::meaning(self.keys, &path) {
                Some(Meaning::Key(key)) => self.check_value(value, &path, key)?,
                Some(Meaning::Table) => self.check_table(value, &path)?,
                _ => match keys::table_with_wrong_id(self.keys, &path) {
                    Some(table) => {
                        let max = if table == "team" { TeamId::MAX } else { VehicleId::MAX.into() };
                        let message = format!("`{}`: {table}s are tables by id, 1 to {max}", shown(&path));
                        return Err(self.fault(name_place, &path, message));
                    }
                    None => return Err(self.unknown(name_place, &path)),
                },
            }
        }
        Ok(())
    }

    /// Checks the value of one key.
    fn check_value(&self, node: &mut Node, path: &str, key: &Key) -> Result<(), ScenarioError> {
        match key.kind {
            Kind::Number(range) => self.number(node, path, range, "a number"),
            Kind::NumberOr(choice, range) => match &node.value {
                Value::Plain(Toml::String(text)) if text == choice => Ok(()),
                _ => self.number(node, path, range, &format!("a number or \"{choice}\"")),
            },
            Kind::Integer(min, max) => self.integer(node, path, min, max),
            Kind::Bool => match node.value {
                Value::Plain(Toml::Boolean(_)) => Ok(()),
                _ => Err(self.wrong(node, path, "true or false")),
            },
            Kind::True => match node.value {
                Value::Plain(Toml::Boolean(true)) => Ok(()),
                _ => Err(self.wrong(node, path, "true, or left out")),
            },
            Kind::OneOf(choices) => self.one_of(node, path, choices.iter().copied()),
            Kind::Law => self.one_of(node, path, law::names()),
            Kind::Name => {
                let name = self.text(node, path)?;
                SwarmName::new(name).map(drop).map_err(|_| {
                    let name = shown(name);
                    self.fault(
                        &node.place,
                        path,
                        format!("`{path}` has to be 1 to 64 letters, digits, '-' or '_'; \"{name}\" is not"),
                    )
                })
            }
            Kind::TomlName => self.toml_name(node, path),
            Kind::Text => self.text(node, path).map(drop),
            Kind::Address(prefix) => self.address(node, path, prefix),
            Kind::Texts => self.each(node, path, "a list of texts", |item| self.text(item, path).map(drop)),
            Kind::Id => self.id(node, path),
            Kind::Ids => self.each(node, path, "a list of vehicle ids", |item| self.id(item, path)),
            Kind::Edges => {
                let pair = "pairs of vehicle ids, sender first: [[1, 2], [2, 3]]";
                self.each(node, path, pair, |item| self.pair(item, path, pair, |end| self.id(end, path)))
            }
            Kind::Point => self.point(node, path),
            Kind::Points => {
                self.each(node, path, "points, [[north, east], [north, east]]", |item| self.point(item, path))
            }
            Kind::Path => self.path(node, path),
            Kind::Tables => self.tables(node, path),
            Kind::Free => match node.value {
                Value::Table(_) => self.free(node, path),
                _ => Err(self.wrong(node, path, "a table")),
            },
        }
    }

    fn number(&self, node: &mut Node, path: &str, range: Range, expected: &str) -> Result<(), ScenarioError> {
        let number = match node.value {
            Value::Plain(Toml::Float(number)) => number,
            Value::Plain(Toml::Integer(number)) => number as f64,
            _ => return Err(self.wrong(node, path, expected)),
        };
        if !range.contains(number) {
            return Err(self.fault(&node.place, path, format!("`{path}` is {number}, out of its range: {range}")));
        }
        node.value = Value::Plain(Toml::Float(number));
        Ok(())
    }

    fn integer(&self, node: &Node, path: &str, min: i64, max: i64) -> Result<(), ScenarioError> {
        match node.value {
            Value::Plain(Toml::Integer(number)) if (min..=max).contains(&number) => Ok(()),
            Value::Plain(Toml::Integer(number)) => {
                Err(self.fault(&node.place, path, format!("`{path}` is {number}, out of its range: {min} to {max}")))
            }
            _ => Err(self.wrong(node, path, "a whole number")),
        }
    }

    fn one_of(
        &self,
        node: &Node,
        path: &str,
        choices: impl Iterator<Item = &'static str> + Clone,
    ) -> Result<(), ScenarioError> {
        let text = self.text(node, path)?;
        if choices.clone().any(|choice| choice == text) {
            return Ok(());
        }
        let list = choices.clone().map(|choice| format!("\"{choice}\"")).collect::<Vec<_>>().join(", ");
        let message = format!("`{path}` is \"{}\", but has to be one of {list}", shown(text));
        let help = keys::nearest_of(choices, text).map(|nearest| format!("did you mean \"{nearest}\"?").into());
        Err(ScenarioError { help, ..self.fault(&node.place, path, message) })
    }

    /// Checks the name of a TOML file, and removes its ending.
    fn toml_name(&self, node: &mut Node, path: &str) -> Result<(), ScenarioError> {
        let text = self.text(node, path)?;
        let name = text.strip_suffix(".toml").unwrap_or(text).to_owned();
        if SwarmName::new(&*name).is_err() {
            let message = format!(
                "`{path}` names a TOML file beside this one by 1 to 64 letters, digits, '-' or '_', with or without \".toml\"; \
                 \"{}\" does not",
                shown(text)
            );
            return Err(self.fault(&node.place, path, message));
        }
        node.value = Value::Plain(Toml::String(name));
        Ok(())
    }

    fn text<'n>(&self, node: &'n Node, path: &str) -> Result<&'n str, ScenarioError> {
        match &node.value {
            Value::Plain(Toml::String(text)) if text.is_empty() || text.chars().any(char::is_control) => {
                Err(self.fault(&node.place, path, format!("`{path}` has to be one line of text that is not empty")))
            }
            Value::Plain(Toml::String(text)) => Ok(text),
            _ => Err(self.wrong(node, path, "a text")),
        }
    }

    /// Checks an address. The largest port leaves room for the vehicle ids that are added to it.
    fn address(&self, node: &Node, path: &str, prefix: &str) -> Result<(), ScenarioError> {
        let text = self.text(node, path)?;
        let parts = text.strip_prefix(prefix).and_then(|rest| rest.rsplit_once(':'));
        let last = u16::MAX - u16::from(VehicleId::MAX);
        match parts {
            Some((host, port))
                if !host.is_empty() && port.parse::<u16>().is_ok_and(|port| (1..=last).contains(&port)) =>
            {
                Ok(())
            }
            _ => {
                let text = shown(text);
                let message = format!("`{path}` is \"{text}\", but has to be {prefix}HOST:PORT, PORT 1 to {last}");
                Err(self.fault(&node.place, path, message))
            }
        }
    }

    fn id(&self, node: &Node, path: &str) -> Result<(), ScenarioError> {
        match node.value {
            Value::Plain(Toml::Integer(id)) if (1..=VehicleId::MAX.into()).contains(&id) => Ok(()),
            Value::Plain(Toml::Integer(id)) => {
                let message = format!("`{path}`: vehicle ids are 1 to {}, not {id}", VehicleId::MAX);
                Err(self.fault(&node.place, path, message))
            }
            _ => Err(self.wrong(node, path, "a vehicle id")),
        }
    }

    /// Checks that the value is a list that is not empty, and checks each entry.
    fn each(
        &self,
        node: &mut Node,
        path: &str,
        expected: &str,
        mut check: impl FnMut(&mut Node) -> Result<(), ScenarioError>,
    ) -> Result<(), ScenarioError> {
        match &mut node.value {
            Value::List(items) if !items.is_empty() => items.iter_mut().try_for_each(&mut check),
            _ => Err(self.wrong(node, path, expected)),
        }
    }

    fn pair(
        &self,
        node: &mut Node,
        path: &str,
        expected: &str,
        check: impl FnMut(&mut Node) -> Result<(), ScenarioError>,
    ) -> Result<(), ScenarioError> {
        if node.list().len() != 2 {
            return Err(self.wrong(node, path, expected));
        }
        self.each(node, path, expected, check)
    }

    fn point(&self, node: &mut Node, path: &str) -> Result<(), ScenarioError> {
        let expected = "a point, [north, east]";
        self.pair(node, path, expected, |end| self.number(end, path, COORDINATES_M, expected))
    }

    /// Checks a path. It must not repeat a point, because two equal points have no direction between them.
    fn path(&self, node: &mut Node, path: &str) -> Result<(), ScenarioError> {
        let expected = "two points or more, [[north, east], [north, east]]";
        self.each(node, path, expected, |item| self.point(item, path))?;
        if node.list().len() < 2 {
            return Err(self.wrong(node, path, expected));
        }
        match node.list().windows(2).find(|two| two[0].plain() == two[1].plain()) {
            Some(two) => Err(self.fault(&two[1].place, path, format!("`{path}`: two points in a row are equal"))),
            None => Ok(()),
        }
    }

    /// Checks a list of tables. Only the list of a mission's steps must not be empty.
    fn tables(&self, node: &mut Node, path: &str) -> Result<(), ScenarioError> {
        if path != "mission.steps" && matches!(&node.value, Value::List(items) if items.is_empty()) {
            return Ok(());
        }
        let mut index = 0;
        self.each(node, path, "a list of one table or more", |item| {
            index += 1;
            self.check_table(item, &format!("{path}[{}]", index - 1))
        })
    }

    /// Checks that JSON can represent the value: JSON has no dates.
    fn free(&self, node: &Node, path: &str) -> Result<(), ScenarioError> {
        match &node.value {
            Value::Plain(Toml::Datetime(_)) => Err(self.wrong(node, path, "a value that JSON can represent")),
            Value::Plain(Toml::Float(number)) if !number.is_finite() => {
                Err(self.wrong(node, path, "a value that JSON can represent"))
            }
            Value::Plain(_) => Ok(()),
            Value::List(items) => items.iter().try_for_each(|item| self.free(item, path)),
            Value::Table(table) => {
                table.iter().try_for_each(|(name, (_, item))| self.free(item, &keys::join(path, name)))
            }
        }
    }

    /// The error for a value of another kind than the key's.
    pub(super) fn wrong(&self, node: &Node, path: &str, expected: &str) -> ScenarioError {
        let found = match &node.value {
            Value::Plain(Toml::String(text)) => format!("\"{}\"", shown(text)),
            Value::Plain(value) => value.to_string(),
            Value::List(items) if items.is_empty() => "an empty list".to_owned(),
            Value::List(_) => "a list".to_owned(),
            Value::Table(_) => "a table".to_owned(),
        };
        if node.list().is_empty() {
            self.fault(&node.place, path, format!("`{path}` has to be {expected}, not {found}"))
        } else {
            self.fault(&node.place, path, format!("`{path}` has to be {expected}"))
        }
    }
}
