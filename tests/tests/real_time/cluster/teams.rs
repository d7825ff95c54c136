//! A fleet of two teams on two hosts, with the files of the book's page on fleets on a cluster, as its operator handles it.

use std::fs;
use std::thread::sleep;
use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::finished::Finished;
use super::host::{Host, kill};
use super::lab::Lab;
use super::page::files;
use super::print_line;

/// The page on fleets on a cluster.
const PAGE: &str = include_str!("../../../../deploy/book/src/cluster-fleets.md");

/// The vehicles of the page's scenario, in order.
const VEHICLES: [&str; 4] = ["1/1", "1/2", "2/1", "2/2"];
/// The vehicle whose agent is killed, and its place in a list of all.
const KILLED: (&str, usize) = ("2/1", 2);
/// Timeout for an agent that was killed to report again.
const SOON: Duration = Duration::from_secs(30);

/// Installs the fleet, flies it, orders one team, kills an agent, lands and removes all.
pub(super) fn fly() {
    let lab = Lab::new("teams", |_| &[]);
    let folder = lab.operator().path("/root/lab");
    fs::create_dir_all(&folder).unwrap();
    files(PAGE).for_each(|(name, text)| fs::write(folder.join(name), text).unwrap());
    let before: Vec<_> = lab.hosts.iter().map(Host::files).collect();
    let skein = |arguments: &str| lab.skein(&format!("{arguments} -f lab/cluster.toml"), 90);
    let cluster = |arguments: &str| skein(&format!("cluster {arguments} --json"));
    let begun = Instant::now();

    cluster("keys").succeeded();
    assert_eq!(each(&cluster("install").succeeded(), "node"), VEHICLES.map(Value::from));
    let up = cluster("up").succeeded();
    assert_eq!(each(&up, "state"), VEHICLES.map(|_| json!("ready")), "{up}");

    let status = cluster("status").succeeded();
    assert_eq!(each(&status, "team"), [1, 1, 2, 2].map(Value::from), "{status}");
    for report in each(&status, "said") {
        assert_eq!([&report["peers_seen"], &report["peers"], &report["refused"]], [1, 1, 0], "{status}");
        // With the other vehicle of the team and with both of the other team; observers are linked to the feed.
        assert_eq!(report["links"], 3, "{status}");
    }
    let table = skein("cluster status").succeeded();
    assert!(VEHICLES.iter().all(|vehicle| table.out.contains(&format!("{vehicle}  "))), "{table}");

    // The second order shows what team 1 did before it: the first order was for team 2 alone.
    for team in [2, 1] {
        let held = skein(&format!("order hold --teams {team}")).succeeded();
        assert!(held.out.contains("vehicle 1, 2: step 0 -> held at step 0"), "{held}");
    }
    assert_eq!(skein("order hold --teams 3").status, Some(2));
    let record = |what: &str| lab.operator().sh(&format!("timeout -s INT 4 skein record -f lab/cluster.toml {what}"));
    let recorded = record("--team 2 --out two.mcap");
    assert!(recorded.out.contains("of 2 vehicles"), "{recorded}");
    let recorded = record("--out fleet.mcap");
    assert!(recorded.out.contains("fleet.mcap: 4 vehicles at "), "{recorded}");
    let page = lab.operator().sh("skein report fleet.mcap --out pages");
    assert!(page.status == Some(0) && page.to_string().contains("pages/index.html"), "{page}");

    let (killed, place) = KILLED;
    let uptimes_s =
        |status: &Finished| each(status, "said").iter().map(|said| said["uptime_s"].as_f64()).collect::<Vec<_>>();
    let host = lab.host(2);
    let agents: Vec<u32> = host.processes(&["skein", "agent"]);
    assert_eq!(agents.len(), 2, "the agents of one team run on this host");
    let (up_s, killed_at) = (uptimes_s(&cluster("status")), Instant::now());
    assert!(up_s.iter().all(Option::is_some), "{up_s:?}");
    agents.into_iter().for_each(kill);
    let back = loop {
        let status = cluster("status");
        if status.status == Some(0) && uptimes_s(&status)[place] < up_s[place] {
            break status;
        }
        assert!(killed_at.elapsed() < SOON, "{status}");
        sleep(Duration::from_millis(200));
    };
    let mut first_team = uptimes_s(&back).into_iter().zip(up_s).take(2);
    assert!(first_team.all(|(now_s, then_s)| now_s > then_s), "an agent of the other team restarted: {back}");
    let logs = skein(&format!("cluster logs {killed} -n 100")).succeeded();
    assert!(logs.out.lines().all(|line| line.starts_with("node-2/1 | ")), "{logs}");

    let down = cluster("down").succeeded();
    assert_eq!(each(&down, "done"), VEHICLES.map(|_| json!("landed")), "{down}");
    let revoked = cluster(&format!("keys --revoke {killed}")).succeeded();
    assert!(revoked.out.contains("\"vehicle-2-1.2\""), "{revoked}");
    cluster("uninstall").succeeded();
    assert!(lab.hosts.iter().map(Host::files).eq(before), "no file is left");
    print_line(&format!(
        "a fleet of two teams installed, flown, ordered, its agents killed and restarted, landed and removed in {:.1} s",
        begun.elapsed().as_secs_f64()
    ));
}

/// One value of each node of a report, in order.
#[track_caller]
fn each(finished: &Finished, key: &str) -> Vec<Value> {
    let report = finished.json();
    report["nodes"].as_array().unwrap().iter().map(|node| node[key].clone()).collect()
}
