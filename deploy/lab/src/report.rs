//! `skein report`: what was flown, as pictures and tables on one page.

pub mod figure;
pub mod flight;
pub mod page;
mod scenarios;
mod study;

use std::path::{Path, PathBuf};

use crate::compare::folder::Folder;
use crate::error::Error;
use crate::out;
use crate::record;
use crate::recording::Recording;
use page::{Page, Part, Section};

/// What to report on, and where to.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  skein report my-study\n  skein report my-study/seed-3/run.mcap --csv")]
pub struct ReportArgs {
    /// Folder of a run or a study, a folder of scenarios (these are flown in virtual time), or a recording
    #[arg(value_name = "DIR|FILE.mcap")]
    pub of: PathBuf,
    /// Folder for what is written, new or empty; without it a new one in skein-runs
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write the recordings as tables too
    #[arg(long)]
    pub csv: bool,
}

/// Reads or flies, draws, writes the page.
///
/// # Errors
/// If there is nothing to report on, or it cannot be written.
pub fn run(ReportArgs { of, out, csv }: &ReportArgs) -> Result<(), Error> {
    let out = out::folder(out.as_deref(), &format!("{}-report", stem(of)))?;
    let recordings = if *csv { recordings(of)? } else { Vec::new() };
    let page = page(of)?;
    page.write(&out)?;
    for (name, path) in recordings {
        let failed = |error| Error::Failed(format!("{}: {error}", path.display()));
        record::csv(&path, &out.join("csv").join(name)).map_err(failed)?;
    }
    eprintln!("written to {}", out.join("index.html").display());
    Ok(())
}

/// The report on what lies here.
fn page(of: &Path) -> Result<Page, Error> {
    if of.is_file() {
        let (recording, title) = recording(of)?;
        let about = flight::subject(&recording.run);
        let section = Section { title: "The flight".to_owned(), name: stem(of), parts: flight_parts(&recording) };
        return Ok(Page { title, about, sections: vec![section] });
    }
    let scenarios = scenarios::in_folder(of)?;
    // A run's folder has its scenario beside its figures.
    if scenarios.is_empty() || of.join("metrics.json").exists() {
        return study::page(&Folder::read(of)?);
    }
    scenarios::page(of, &scenarios)
}

/// All recordings that lie here, with a name each.
fn recordings(of: &Path) -> Result<Vec<(String, PathBuf)>, Error> {
    if of.is_file() {
        return Ok(vec![(stem(of), of.to_owned())]);
    }
    let runs = Folder::read(of)?.runs.into_iter().map(|run| run.folder.join(record::FILE));
    let name = |path: &Path| {
        let folder =
            path.parent().and_then(|folder| folder.strip_prefix(of).ok()).filter(|inside| *inside != Path::new(""));
        folder.map_or_else(|| stem(path), |folder| slug(&folder.display().to_string()))
    };
    let found: Vec<_> = runs.filter(|path| path.is_file()).map(|path| (name(&path), path)).collect();
    if found.is_empty() {
        return Err(Error::Refused(format!("--csv: no run in {} is recorded", of.display())));
    }
    Ok(found)
}

/// A recording, and what to call it.
fn recording(path: &Path) -> Result<(Recording, String), Error> {
    let recording = record::read(path).map_err(|error| Error::Refused(format!("{}: {error}", path.display())))?;
    let title = format!("{}, seed {}", recording.run.scenario, recording.run.seed);
    Ok((recording, title))
}

/// All that is drawn of a flight.
fn flight_parts(recording: &Recording) -> Vec<Part> {
    flight::figures(recording).into_iter().map(Part::Figure).collect()
}

/// The last part of a path, without its ending.
fn stem(path: &Path) -> String {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let stem = absolute.file_stem().unwrap_or_default().to_string_lossy();
    slug(&stem)
}

/// A name that files may have anywhere.
fn slug(name: &str) -> String {
    name.chars().map(|letter| if letter.is_alphanumeric() || letter == '_' { letter } else { '-' }).collect()
}
