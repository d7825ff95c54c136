//! Orders from pages, where the operator allows them: each is given as `skein order` gives it, and the page receives which
//! vehicles have taken it.
//!
//! Without a token only pages on this PC may give orders. With one every order must carry it. The server compares it in a time
//! that does not depend on how much of it is right, counts wrong ones, and answers them late.

use std::fs;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use ring::hmac;
use ring::rand::SystemRandom;
use serde::Deserialize;
use serde_json::json;
use skein_common::id::{TeamId, VehicleName};
use skein_common::message::Verb;
use skein_lab::error::Error;
use skein_lab::terminal::complain;
use tokio::sync::Semaphore;

use skein_cluster::mesh::order::{self, Chosen};
use skein_cluster::mesh::reach::Place;
use skein_cluster::os;

/// The environment variable with the token.
const VARIABLE: &str = "SKEIN_ORDERS_TOKEN";
/// Shortest token, characters: too long to be guessed.
const SHORTEST_TOKEN: usize = 16;
/// Longest token, characters: an order with it fits into a page's message.
const LONGEST_TOKEN: usize = 1024;
/// Time after which a wrong token is answered.
const WRONG_AFTER: Duration = Duration::from_secs(1);
/// Largest number of orders that are given at the same time.
const MOST_AT_ONCE: usize = 8;

/// Options about orders from the page.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct OrdersArgs {
    /// Let the page and ground stations give orders. Without a token only on the loopback
    #[arg(long)]
    pub orders: bool,
    /// File with the token that a page has to send with every order, at least 16 characters; the environment variable
    /// SKEIN_ORDERS_TOKEN can have the token instead
    #[arg(long, value_name = "FILE", requires = "orders")]
    pub token: Option<PathBuf>,
}

impl OrdersArgs {
    /// Returns the rule by which pages of a server that listens at this address give orders; `None` if they may not.
    ///
    /// # Errors
    /// If pages on other PCs could give orders without a token, or the token cannot be read or is too short.
    pub(super) fn rule(&self, listen: IpAddr) -> Result<Option<Arc<Rule>>, Error> {
        if !self.orders {
            return Ok(None);
        }
        let token = match (&self.token, std::env::var(VARIABLE)) {
            (Some(path), _) => Some(Token::read(path)?),
            (None, Ok(text)) => Some(Token::new(VARIABLE, &text)?),
            (None, Err(_)) => None,
        };
        if token.is_none() && !listen.is_loopback() {
            return Err(Error::Refused(format!(
                "--orders: every PC that reaches {listen} could order the swarm: set a token with --token FILE or {VARIABLE}, or \
                 serve the page on the loopback"
            )));
        }
        Ok(Some(Arc::new(Rule { token, wrong: AtomicU64::new(0), free: Semaphore::new(MOST_AT_ONCE) })))
    }
}

/// The token of the pages that may give orders: its authentication code under a key of this process. The codes of two texts can be
/// compared in constant time, whatever their lengths.
struct Token {
    key: hmac::Key,
    code: hmac::Tag,
}

impl Token {
    fn read(path: &Path) -> Result<Self, Error> {
        let name = path.display().to_string();
        let failed = |error: std::io::Error| Error::Refused(format!("--token {name}: {error}"));
        if !os::is_private(path).map_err(failed)? {
            return Err(Error::Refused(format!("--token {name}: other users can read it: `chmod 600 {name}`")));
        }
        Self::new(&name, &fs::read_to_string(path).map_err(failed)?)
    }

    /// The token in this text from the source with this name, without the blanks around it.
    fn new(source: &str, text: &str) -> Result<Self, Error> {
        let token = text.trim();
        let length = token.chars().count();
        if !(SHORTEST_TOKEN..=LONGEST_TOKEN).contains(&length) {
            return Err(Error::Refused(format!(
                "{source}: a token has {SHORTEST_TOKEN} to {LONGEST_TOKEN} characters, and this one {length}; `openssl rand -hex 16` \
                 makes one"
            )));
        }
        let key = hmac::Key::generate(hmac::HMAC_SHA256, &SystemRandom::new())
            .map_err(|_| Error::Failed("this PC has no source of random numbers".to_owned()))?;
        let code = hmac::sign(&key, token.as_bytes());
        Ok(Self { key, code })
    }

    fn is(&self, candidate: &str) -> bool {
        hmac::verify(&self.key, candidate.as_bytes(), self.code.as_ref()).is_ok()
    }
}

/// The rule by which pages give orders.
pub(super) struct Rule {
    token: Option<Token>,
    /// Number of orders with a wrong token.
    wrong: AtomicU64,
    /// One for each order that can still be begun.
    free: Semaphore,
}

impl Rule {
    /// Whether an order needs a token.
    pub(super) fn needs_token(&self) -> bool {
        self.token.is_some()
    }
}

/// An order as a page sends it.
#[derive(Clone, PartialEq, Deserialize)]
pub(super) struct PageOrder {
    verb: String,
    step: Option<u32>,
    /// Names of the vehicles that it is to; without them and without teams it is to all.
    vehicles: Option<Vec<VehicleName>>,
    /// Teams of a fleet that it is to.
    teams: Option<Vec<TeamId>>,
    token: Option<String>,
}

impl std::fmt::Debug for PageOrder {
    /// Everything but the token.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { verb, step, vehicles, teams, token: _ } = self;
        write!(f, "PageOrder({verb:?}, {step:?}, {vehicles:?}, {teams:?})")
    }
}

impl PageOrder {
    /// The action and the vehicles.
    fn read(self) -> Result<(Verb, Chosen), Error> {
        let refused = |why: &str| Err(Error::Refused(why.to_owned()));
        let verb = match (self.verb.as_str(), self.step) {
            ("hold", None) => Verb::Hold,
            ("land", None) => Verb::Land,
            ("abort", None) => Verb::Abort,
            ("release", None) => Verb::Release,
            ("goto", Some(step)) => Verb::Goto(step),
            ("goto", None) => return refused("goto: name the step, counted from 0"),
            ("hold" | "land" | "abort" | "release", Some(_)) => return refused("only goto has a step"),
            _ => return refused("the orders are hold, goto, land, abort and release"),
        };
        match (self.vehicles, self.teams) {
            (Some(_), Some(_)) => refused("an order names vehicles or teams, not both"),
            (Some(names), None) => Ok((verb, Chosen::Vehicles(names))),
            (None, Some(teams)) if teams.is_empty() => refused("the order names no team: name some, or order all"),
            (None, Some(teams)) => Ok((verb, Chosen::Teams(teams))),
            (None, None) if verb == Verb::Release => {
                refused("release: select the vehicles that human pilots are to fly")
            }
            (None, None) => Ok((verb, Chosen::Teams(Vec::new()))),
        }
    }
}

/// The message to the page about what became of its order.
pub(super) fn answer(text: &str, is_done: bool) -> String {
    json!({ "type": "ordered", "text": text, "ok": is_done }).to_string()
}

/// Gives a page's order to the swarm in this place if the rule allows it, and returns the message about what became of it.
pub(super) async fn give(rule: Option<Arc<Rule>>, place: Option<Arc<Place>>, order: PageOrder) -> String {
    match try_give(rule, place, order).await {
        Ok((text, is_done)) => answer(&text, is_done),
        Err(error) => answer(&error.to_string(), false),
    }
}

async fn try_give(
    rule: Option<Arc<Rule>>,
    place: Option<Arc<Place>>,
    order: PageOrder,
) -> Result<(String, bool), Error> {
    let refused = |why: &str| Error::Refused(why.to_owned());
    let rule = rule.ok_or_else(|| refused("this page takes no orders: start its server with --orders"))?;
    if let Some(token) = &rule.token
        && !token.is(order.token.as_deref().unwrap_or_default())
    {
        let count = rule.wrong.fetch_add(1, Relaxed) + 1;
        complain(&format!("an order with a wrong token was refused, {count} since the page is served"));
        tokio::time::sleep(WRONG_AFTER).await;
        return Err(refused("wrong token: enter the one that the server was started with"));
    }
    let place = place.ok_or_else(|| refused("no swarm has been found yet: wait until the page shows one"))?;
    let (verb, chosen) = order.read()?;
    let Ok(_free) = rule.free.try_acquire() else {
        return Err(refused("too many orders at once: wait for the answer to one"));
    };
    // An order waits for its vehicles, seconds long.
    let given = tokio::task::spawn_blocking(move || order::give_to(&place, verb, &chosen)).await;
    given.unwrap_or_else(|_| Err(Error::Failed(format!("{verb}: the order failed"))))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOKEN: &str = "0123456789abcdef";

    fn args(token: Option<PathBuf>) -> OrdersArgs {
        OrdersArgs { orders: true, token }
    }

    fn refusal(result: Result<impl Sized, Error>) -> String {
        let error = result.err().unwrap();
        assert_eq!(error.exit_code(), 2);
        error.to_string()
    }

    fn order(text: &str) -> PageOrder {
        serde_json::from_str(text).unwrap()
    }

    fn gives(rule: Option<Arc<Rule>>, text: &str) -> serde_json::Value {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().unwrap();
        serde_json::from_str(&runtime.block_on(give(rule, None, order(text)))).unwrap()
    }

    #[test]
    fn pages_on_other_pcs_give_no_orders_without_a_token() {
        let here: IpAddr = "127.0.0.1".parse().unwrap();
        assert!(OrdersArgs::default().rule(here).unwrap().is_none());
        assert!(!args(None).rule(here).unwrap().unwrap().needs_token());
        for there in ["0.0.0.0", "10.0.0.5", "::"] {
            let why = refusal(args(None).rule(there.parse().unwrap()));
            assert!(why.contains(there) && why.contains("--token FILE or SKEIN_ORDERS_TOKEN"), "{why}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_token_is_read_from_a_private_file_and_long_enough() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("token");
        let rule = || args(Some(path.clone())).rule("0.0.0.0".parse().unwrap());
        assert!(refusal(rule()).starts_with(&format!("--token {}: ", path.display())));
        fs::write(&path, format!("{TOKEN}\n")).unwrap();
        os::set_mode(&path, 0o644).unwrap();
        assert!(refusal(rule()).contains("`chmod 600 "));
        os::set_mode(&path, 0o600).unwrap();
        let rule_of_file = rule().unwrap().unwrap();
        assert!(rule_of_file.needs_token());
        let token = rule_of_file.token.as_ref().unwrap();
        assert!(token.is(TOKEN));
        for wrong in ["", "0", "0123456789abcde", "0123456789abcdef0", "0123456789abcdeF"] {
            assert!(!token.is(wrong), "{wrong:?}");
        }
        fs::write(&path, "short").unwrap();
        assert!(refusal(rule()).contains("16 to 1024 characters, and this one 5"));
    }

    #[test]
    fn an_order_without_permission_or_with_a_wrong_token_is_refused_and_counted() {
        let answered = gives(None, r#"{"verb":"land"}"#);
        assert_eq!((&answered["type"], &answered["ok"]), (&json!("ordered"), &json!(false)));
        assert!(answered["text"].as_str().unwrap().contains("start its server with --orders"), "{answered}");

        let token = Some(Token::new("test", TOKEN).unwrap());
        let rule = Arc::new(Rule { token, wrong: AtomicU64::new(0), free: Semaphore::new(1) });
        let text = |order: &str| gives(Some(Arc::clone(&rule)), order)["text"].as_str().unwrap().to_owned();
        assert!(text(r#"{"verb":"land"}"#).starts_with("wrong token"));
        assert!(text(r#"{"verb":"land","token":"0123456789abcdeg"}"#).starts_with("wrong token"));
        assert_eq!(rule.wrong.load(Relaxed), 2);
        assert!(text(&format!(r#"{{"verb":"land","token":"{TOKEN}"}}"#)).starts_with("no swarm has been found"));
        assert_eq!(rule.wrong.load(Relaxed), 2);
        let debug = format!("{:?}", order(&format!(r#"{{"verb":"land","token":"{TOKEN}"}}"#)));
        assert!(!debug.contains(TOKEN), "{debug}");
    }

    #[test]
    fn an_order_names_vehicles_or_teams_or_is_to_all() {
        let read = |text: &str| order(text).read();
        assert!(
            matches!(read(r#"{"verb":"goto","step":3}"#), Ok((Verb::Goto(3), Chosen::Teams(none))) if none.is_empty())
        );
        let named = read(r#"{"verb":"release","vehicles":["2/7",3],"teams":null}"#);
        assert!(matches!(named, Ok((Verb::Release, Chosen::Vehicles(names))) if names.len() == 2));
        assert!(
            matches!(read(r#"{"verb":"land","teams":[2]}"#), Ok((Verb::Land, Chosen::Teams(two))) if two.len() == 1)
        );
        for (text, why) in [
            (r#"{"verb":"fly"}"#, "the orders are"),
            (r#"{"verb":"goto"}"#, "name the step"),
            (r#"{"verb":"land","step":1}"#, "only goto"),
            (r#"{"verb":"hold","vehicles":["1"],"teams":[1]}"#, "not both"),
            (r#"{"verb":"hold","teams":[]}"#, "no team"),
            (r#"{"verb":"release"}"#, "select the vehicles"),
        ] {
            assert!(refusal(read(text)).contains(why), "{text}");
        }
        for garbage in [r#"{"verb":"hold","vehicles":"1"}"#, r#"{"verb":"hold","vehicles":[0]}"#, r#"{"verb":7}"#] {
            assert!(serde_json::from_str::<PageOrder>(garbage).is_err(), "{garbage}");
        }
    }
}
