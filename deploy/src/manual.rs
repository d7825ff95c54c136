//! `skein completions` and `skein man`: what a package installs beside the program, made from the command line's definition.

use std::fs;
use std::path::PathBuf;

use clap::Command;
use clap_complete::Shell;
use skein_lab::error::Error;
use skein_lab::terminal::{draw, of_writing, say};

/// `skein completions`
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  skein completions bash > ~/.local/share/bash-completion/completions/skein\n  skein completions zsh > ~/.zfunc/_skein"
)]
pub struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    pub shell: Shell,
}

/// `skein man`
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  skein man --out man1\n  skein man --out ~/.local/share/man/man1")]
pub struct ManArgs {
    /// The folder for the pages
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
}

/// Prints the completions for a shell.
pub fn complete(args: &CompletionsArgs, mut program: Command) {
    // Not written to stdout at once: there a closed pipe (`| head`) would be an error.
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut program, "skein", &mut text);
    draw(&String::from_utf8_lossy(&text));
}

/// Writes a manual page for the program and for each of its commands.
///
/// # Errors
/// If a page cannot be written.
pub fn write_pages(args: &ManArgs, program: Command) -> Result<(), Error> {
    let written = fs::create_dir_all(&args.out).and_then(|()| clap_mangen::generate_to(program, &args.out));
    written.map_err(|error| Error::Failed(format!("{}: {}", args.out.display(), of_writing(&error))))?;
    say(&format!("manual pages written to {}\n", args.out.display()));
    Ok(())
}
