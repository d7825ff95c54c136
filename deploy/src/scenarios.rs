//! `skein files scenarios`: the scenarios that come with the program.

use serde::Serialize;
use skein_common::scenario::Source;
use skein_lab::error::Error;
use skein_lab::shipped::{self, SCENARIOS};
use skein_lab::terminal::{json, say, wrapped};

use skein_cluster::display::screen::columns;

/// `skein files scenarios`
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  skein files scenarios\n  skein files scenarios tour > my-tour.toml")]
pub struct ScenariosArgs {
    /// Print the file of this scenario; without a name, list all
    #[arg(value_name = "NAME")]
    pub name: Option<String>,
    /// Print a JSON array of objects {name, about}
    #[arg(long, conflicts_with = "name")]
    pub json: bool,
}

/// A shipped scenario in the list.
#[derive(Debug, Serialize)]
struct Listed {
    /// The name by which it flies.
    name: &'static str,
    /// The sentence about it.
    about: String,
}

/// Prints the list, or the text of one scenario.
///
/// # Errors
/// If no shipped scenario has the name.
pub fn run(args: &ScenariosArgs) -> Result<(), Error> {
    let text = match &args.name {
        Some(name) => shipped::find(name)?.text.to_owned(),
        None if args.json => json(&SCENARIOS.iter().map(listed).collect::<Vec<_>>()),
        None => list(columns()),
    };
    say(&text);
    Ok(())
}

fn listed(shipped: &Source<'static>) -> Listed {
    Listed { name: shipped::name_of(shipped), about: shipped::about(shipped) }
}

/// Each name with its text beside it, wrapped to this many columns.
fn list(columns: usize) -> String {
    let indent = SCENARIOS.iter().map(|shipped| shipped::name_of(shipped).len()).max().unwrap_or(0) + 2;
    let entry = |shipped: &Source<'static>| {
        let Listed { name, about } = listed(shipped);
        let lines = wrapped(&about, columns.saturating_sub(indent + 1).max(20));
        let line = |(nth, line): (usize, &String)| format!("{:indent$}{line}\n", if nth == 0 { name } else { "" });
        lines.iter().enumerate().map(line).collect::<String>()
    };
    SCENARIOS.iter().map(entry).collect::<String>()
        + "\nskein fly NAME and skein study NAME fly one; skein files scenarios NAME prints its file.\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_line_of_the_list_fits() {
        let list = list(80);
        assert!(list.lines().all(|line| line.chars().count() <= 90), "{list}");
        assert!(list.starts_with("hover         Four helicopters"), "{list}");
        assert_eq!(SCENARIOS.iter().filter(|shipped| list.contains(shipped::name_of(shipped))).count(), 10);
    }
}
