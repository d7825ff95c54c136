//! Orders from the page on a cluster with keys: the operator's PC serves the page, and its browser, here a process of the test on
//! that PC, gives the order.

use std::io::Write;
use std::net::SocketAddr;
use std::process::Stdio;
use std::time::Duration;

use serde_json::{Value, json};
use skein_tests::page_client::Socket;

use super::finished::Finished;
use super::lab::Lab;

const ADDRESS: &str = "127.0.0.1:7490";
/// Environment variable of the browser's process with the verb of its order.
const VERB_VARIABLE: &str = "SKEIN_PAGE_ORDER";

/// Gives the whole swarm this order from the page; returns what the page shows.
pub(super) fn from_the_page(lab: &Lab, verb: &str) -> Value {
    let operator = lab.operator();
    operator.put_program(&std::env::current_exe().unwrap(), "/opt/browser");
    let mut view = operator.command("skein");
    view.args(["view", "-f", "lab/cluster.toml", "--orders", "--listen", ADDRESS]);
    let mut view = view.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let mut browser = operator.command("env");
    browser.arg(format!("{VERB_VARIABLE}={verb}")).arg("/opt/browser");
    let finished = Finished::of(
        browser.args(["--exact", "cluster::browser", "--ignored", "--nocapture"]),
        Duration::from_secs(60),
    );
    operator.processes(&["skein", "view"]).into_iter().for_each(super::host::kill);
    let _ = view.wait();
    let shown = finished.out.lines().find_map(|line| serde_json::from_str(line).ok().filter(Value::is_object));
    shown.unwrap_or_else(|| panic!("the page shows no answer: {finished}"))
}

/// The process of the browser.
pub(super) fn browse() {
    let Ok(verb) = std::env::var(VERB_VARIABLE) else { return };
    let address: SocketAddr = ADDRESS.parse().unwrap();
    while std::net::TcpStream::connect(address).is_err() {
        std::thread::sleep(Duration::from_millis(50));
    }
    let mut page = Socket::open(address);
    page.wait_for("swarm", |message| {
        let vehicles = message["vehicles"]
            .as_array()
            .map_or(0, |all| all.iter().filter(|one| one["phase"] == "formation").count());
        message["type"] == "snapshot" && vehicles == usize::from(super::lab::HOSTS)
    });
    page.send(&json!({ "type": "order", "verb": verb, "vehicles": null, "teams": null, "token": "" }).to_string());
    let shown = page.wait_for("answer", |message| message["type"] == "ordered");
    writeln!(std::io::stdout().lock(), "\n{shown}").unwrap();
}
