use skein_lab::metrics::traffic_csv;

use super::*;

fn row(vehicle: &str, messages: f64, others: Option<f64>, links: Option<u32>) -> VehicleTraffic {
    VehicleTraffic {
        vehicle: vehicle.to_owned(),
        counted_s: 60.0,
        links,
        messages_per_s: messages,
        bytes_per_s: 60.0 * messages,
        others_messages_per_s: others,
        others_bytes_per_s: others.map(|others| 70.0 * others),
    }
}

/// Two vehicles of a fleet in virtual time.
pub(in super::super) fn flown() -> FlownFleet {
    let rows = [row("1/1", 100.0, Some(30.0), None), row("2/1", 200.0, Some(130.0), None)];
    FlownFleet::of("two teams".to_owned(), &rows).unwrap()
}

#[test]
fn what_was_received_is_the_mean_and_the_most_of_the_vehicles() {
    let flown = flown();
    let figure = |mean: f64, most: f64| OverVehicles { mean, most };
    assert_eq!(flown.own_team.unwrap().messages_per_s, figure(70.0, 70.0));
    assert_eq!(flown.other_teams.unwrap().messages_per_s, figure(80.0, 130.0));
    assert_eq!((flown.all.bytes_per_s, flown.links), (figure(9000.0, 12_000.0), None));
}

#[test]
fn a_live_fleet_has_links_and_no_parts_and_a_folder_without_a_fleet_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let refused = FlownFleet::read(folder.path()).unwrap_err();
    assert!(refused.exit_code() == 2 && refused.to_string().contains("the folder of a run of a fleet"), "{refused}");
    let rows = [row("1/1", 100.0, None, Some(7)), row("2/1", 200.0, None, Some(9))];
    std::fs::write(folder.path().join(TRAFFIC_FILE), traffic_csv(&rows)).unwrap();
    let flown = FlownFleet::read(folder.path()).unwrap();
    assert_eq!((flown.own_team, flown.other_teams, flown.vehicles), (None, None, 2));
    assert_eq!(flown.links, Some(OverVehicles { mean: 8.0, most: 9.0 }));
}

#[test]
fn a_flown_fleet_receives_its_own_team_and_the_teams_near_by() {
    let flown = FlownFleet::fly(3.0).unwrap();
    let (own, others) = (flown.own_team.unwrap(), flown.other_teams.unwrap());
    // Seven others with about five heartbeats and five states a second each; a state is sent more often at the take-off.
    assert!((50.0..200.0).contains(&own.messages_per_s.mean), "{own:?}");
    assert!(others.messages_per_s.most > own.messages_per_s.most, "{others:?}");
    assert!(flown.all.messages_per_s.most < 287.0 * 10.0 && flown.links.is_none(), "{flown:?}");
}
