//! `reference/commands.md`: the long help of every command.

use clap::{Command, CommandFactory};
use skein::cli::{Cli, FOR_EXPERTS};

/// The columns of the help.
const COLUMNS: usize = 100;

/// The page.
pub(super) fn page() -> String {
    let mut program = Cli::command().term_width(COLUMNS);
    program.build();
    let body = format!("## skein\n\n{}{}", help(&mut program), subcommands(&mut program));
    let purpose = "After reading this page you can give every command its options. It has what each command prints with \
                   `--help`.";
    super::page("Commands", purpose, "the definitions of the command line", &body)
}

/// The help in a fence.
fn help(command: &mut Command) -> String {
    let help = command.render_long_help().to_string();
    let lines: Vec<_> = help.trim_end().lines().map(str::trim_end).collect();
    format!("```text\n{}\n```\n\n", lines.join("\n"))
}

/// A section for each command below this one; `skein cluster keys` comes after `skein cluster`.
fn subcommands(command: &mut Command) -> String {
    let is_shown = |command: &&mut Command| {
        FOR_EXPERTS.contains(&command.get_name()) || !command.is_hide_set() && command.get_name() != "help"
    };
    let section = |command: &mut Command| {
        let name = command.get_bin_name().unwrap_or_default().to_owned();
        format!("## {name}\n\n{}{}", help(command), subcommands(command))
    };
    command.get_subcommands_mut().filter(is_shown).map(section).collect()
}
