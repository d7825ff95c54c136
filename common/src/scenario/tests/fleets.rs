//! Files with `[fleet]`.

use super::*;
use crate::frame::Origin;

/// The scenarios of a fleet's teams, or the error.
fn try_teams(text: &str, sets: &[&str]) -> Result<Vec<Loaded>, String> {
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    match load_any(&Source { name: "a.toml", text }, &sets) {
        Ok(described) if described.is_fleet() => Ok(described.all().to_vec()),
        Ok(_) => Err("one swarm".to_owned()),
        Err(error) => Err(error.to_string()),
    }
}

fn teams(text: &str, sets: &[&str]) -> Vec<Loaded> {
    try_teams(text, sets).unwrap_or_else(|error| panic!("{error}"))
}

const FLEET: &str = "[fleet]\nteams = 5\nspacing_m = 400\n[swarm]\nvehicles = 4\n[formation]\nradius_m = 80\n\
                     [[team]]\nids = [2, 3]\nformation.radius_m = 60\nswarm.vehicles = 6\n\
                     [[team]]\nids = 3\nformation.radius_m = 50\n";

fn radii_m(teams: &[Loaded]) -> Vec<f64> {
    teams.iter().map(|team| team.scenario.formation.radius_m).collect()
}

#[test]
fn a_file_without_a_fleet_is_read_as_before() {
    let text = "swarm.vehicles = 4\nseed = 7";
    let swarm = load_any(&Source { name: "a.toml", text }, &[]).unwrap().into_team(None).unwrap();
    let alone = loaded(text, &[]);
    assert_eq!((swarm.scenario.clone(), swarm.to_toml()), (alone.scenario.clone(), alone.to_toml()));
    assert_eq!(swarm.scenario.team, None);
    assert!(!swarm.to_toml().contains("fleet"));
}

#[test]
fn each_team_has_the_files_values_with_its_own_changes() {
    let read = teams(FLEET, &[]);
    assert_eq!(radii_m(&read), [80.0, 60.0, 50.0, 80.0, 80.0], "the later table wins");
    let vehicles: Vec<_> = read.iter().map(|team| team.scenario.swarm.vehicles).collect();
    assert_eq!(vehicles, [4, 6, 6, 4, 4]);
    let ids: Vec<_> = read.iter().map(|team| team.scenario.team.unwrap().id.get()).collect();
    assert_eq!(ids, [1, 2, 3, 4, 5]);
}

#[test]
fn options_are_for_all_teams_for_one_or_for_the_fleet() {
    let sets = ["formation.radius_m=90", "team.4.formation.radius_m=70"];
    assert_eq!(radii_m(&teams(FLEET, &sets)), [90.0, 90.0, 90.0, 70.0, 90.0]);
    assert_eq!(teams(FLEET, &["fleet.teams=3"]).len(), 3);
}

#[test]
fn places_are_a_grid_a_line_or_a_list_around_the_origin() {
    let places = |sets: &[&str]| -> Vec<[f64; 2]> {
        teams(FLEET, sets).iter().map(|team| team.scenario.team.unwrap().place_ne_m).collect()
    };
    let grid = [[-200.0, -400.0], [-200.0, 0.0], [-200.0, 400.0], [200.0, -400.0], [200.0, 0.0]];
    assert_eq!(places(&[]), grid);
    let line = [[0.0, -800.0], [0.0, -400.0], [0.0, 0.0], [0.0, 400.0], [0.0, 800.0]];
    assert_eq!(places(&["fleet.pattern=line"]), line);
    let listed = ["fleet.pattern=list", "fleet.places_ne_m=[[0,0],[1,2],[3,4],[5,6],[7,8]]"];
    assert_eq!(places(&listed), [[0.0, 0.0], [1.0, 2.0], [3.0, 4.0], [5.0, 6.0], [7.0, 8.0]]);
}

#[test]
fn a_teams_origin_is_its_place_at_the_fleets_elevation() {
    let read = teams(FLEET, &["origin.elevation_m=30"]);
    for Loaded { scenario, .. } in &read {
        let team = scenario.team.unwrap();
        let place = Origin::new(team.origin.geodetic()).ned_from_geodetic(&scenario.origin.geodetic());
        let [north_m, east_m] = team.place_ne_m;
        assert!((place.north_m() - north_m).abs() < 1e-2 && (place.east_m() - east_m).abs() < 1e-2, "{place:?}");
        assert_eq!(scenario.origin.elevation_m, 30.0);
    }
}

#[test]
fn teams_have_different_seeds_and_a_file_of_their_own() {
    let read = teams(FLEET, &[]);
    let seeds: std::collections::BTreeSet<_> = read.iter().map(|team| team.scenario.seed).collect();
    assert_eq!(seeds.len(), 5);
    for team in &read {
        let again = loaded(&team.to_toml(), &[]).scenario;
        assert_eq!(Scenario { team: team.scenario.team, ..again }, team.scenario);
    }
}

#[test]
fn a_fleet_of_one_team_has_a_complete_file() {
    let described = load_any(&Source { name: "a.toml", text: "swarm.vehicles = 1\nfleet.teams = 1" }, &[]).unwrap();
    let again = load_any(&Source { name: "again.toml", text: &described.to_toml() }, &[]).unwrap();
    assert_eq!(described.all()[0].scenario, again.all()[0].scenario);
}

#[test]
fn the_complete_file_of_a_fleet_gives_the_same_teams() {
    let text = FLEET.to_owned()
        + "[mission]\nsteps = [{ centre_ne_m = [0, 0] }, { land = true }]\n[[team]]\nids = [4]\nseed = 9\n\
                                   mission.steps = [{ centre_ne_m = [50, 0] }]\nrecorded = true\nvehicle.2.start_ne_m = [7.0, 100.0]\n";
    let described = load_any(&Source { name: "a.toml", text: &text }, &["seed=3".into()]).unwrap();
    let again = load_any(&Source { name: "again.toml", text: &described.to_toml() }, &[]).unwrap();
    let scenarios =
        |described: &Described| -> Vec<_> { described.all().iter().map(|team| team.scenario.clone()).collect() };
    for (one, other) in scenarios(&described).iter().zip(&scenarios(&again)) {
        assert_eq!(one, other, "{}", described.to_toml());
    }
    assert_eq!((described.seed(), described.all().len()), (3, 5));
}

#[test]
fn a_fleet_with_a_mistake_is_refused_at_its_position() {
    let fleet = |rest: &str| format!("swarm.vehicles = 4\n{rest}");
    let cases = [
        ("[fleet]\nspacing_m = 5", "a.toml:2:2: `fleet.teams` is missing; add the number of teams: `teams = 4`"),
        ("[fleet]\nteams = 0", "a.toml:3:9: `fleet.teams` is 0, out of its range: 1 to 4096"),
        ("[fleet]\nteam = 4", "a.toml:3:1: unknown key `fleet.team`; did you mean `fleet.teams`?"),
        ("[[team]]\nids = [1]", "a.toml:2:3: `[[team]]` without `[fleet]`; add `[fleet]`, `teams = 4`"),
        (
            "[fleet]\nteams = 2\n[[team]]\nseed = 3",
            "a.toml:4:1: `team.ids` is missing; add the numbers of the teams: `ids = [1]`",
        ),
        (
            "[fleet]\nteams = 2\n[[team]]\nids = [1, 3]",
            "a.toml:5:11: `team.ids` has to be a list of numbers of teams, 1 to 2",
        ),
        (
            "[fleet]\nteams = 2\n[[team]]\nids = 1\norigin.latitude_deg = 3",
            "a.toml:6:1: `origin` is the same for all teams of a fleet",
        ),
        (
            "[fleet]\nteams = 2\n[[team]]\nids = 1\nformation.raduis_m = 3",
            "a.toml:6:11: unknown key `formation.raduis_m`; did you mean `formation.radius_m`?",
        ),
        (
            "[fleet]\nteams = 2\nplaces_ne_m = [[0, 0], [1, 1]]",
            "a.toml:4:15: `fleet.places_ne_m` has no effect: `fleet.pattern` is \"grid\"",
        ),
        (
            "[fleet]\nteams = 4000\npattern = 'line'\nspacing_m = 60",
            "a.toml:5:13: team 1 would be at [0, -119970]; points have the range -100000 to 100000",
        ),
        ("[fleet]\nteams = 2\nspacing_m = 5e-324", "a.toml:4:13: teams 1 and 2 would have the same place"),
        (
            "[fleet]\nteams = 3\npattern = 'list'\nplaces_ne_m = [[0, 0], [9, 9], [-0.0, 0]]",
            "a.toml:5:15: teams 1 and 3 would have the same place",
        ),
        (
            "[fleet]\nteams = 3\npattern = 'list'\nplaces_ne_m = [[0, 0], [1, 1]]",
            "a.toml:5:15: `fleet.places_ne_m` has 2 places for 3 teams",
        ),
    ];
    for (rest, expected) in cases {
        assert_eq!(try_teams(&fleet(rest), &[]).unwrap_err(), expected, "{rest}");
    }
    let set = |set| try_teams(FLEET, &[set]).unwrap_err();
    assert_eq!(set("team.9.seed=3"), "--set team.9.seed=3: the fleet has teams 1 to 5, not 9");
    let expected = "--set team.2.sead=3: unknown key `sead`; did you mean `seed`?";
    assert_eq!(set("team.2.sead=3"), expected);
    assert!(set("fleet.temas=3").contains("did you mean `fleet.teams`?"));
}

#[test]
fn one_swarm_is_no_fleet() {
    let error = try_load("a.toml", FLEET, &[]).unwrap_err().to_string();
    assert_eq!(error, "a.toml:1:1: this is a fleet of several teams, not one swarm");
    let error = try_load("a.toml", "swarm.vehicles = 4", &["team.2.seed=3"]).unwrap_err().to_string();
    assert!(error.contains("unknown key `team.2.seed`"), "{error}");
}
