//! The run that this PC began last: `run.json` in the folder of keys. It outlives the flight, so that no host can pass an old
//! run off as the one that flies.

use serde::{Deserialize, Serialize};
use skein_agent::link::seal::runs::RunNote;
use skein_common::message::Verb;

use super::folder::Folder;
use crate::inventory::{Inventory, SecurityKind};
use skein_lab::error::Error;

/// Its file.
pub(crate) const RUN: &str = "run.json";

/// The newest run that was begun or joined from this PC.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Record {
    pub(crate) note: RunNote,
    /// It is not to be joined again on the strength of this note: every vehicle of it is known to have ended, or there is a
    /// sealed order to land or to abort, which would bring down whatever is started in it.
    pub(crate) over: bool,
}

impl Record {
    pub(crate) fn of(note: RunNote) -> Self {
        Self { note, over: false }
    }
}

/// Where the record is kept.
#[derive(Clone, Debug)]
pub struct RunFile(Folder);

impl RunFile {
    pub(crate) fn of(inventory: &Inventory) -> Option<Self> {
        (inventory.security == SecurityKind::Tls).then(|| Self(Folder(inventory.keys.clone())))
    }

    /// The record of the run that was begun from this PC last, if there is one.
    ///
    /// # Errors
    /// If the file cannot be read, or is none of ours.
    pub(crate) fn read(&self) -> Result<Option<Record>, Error> {
        let Some(text) = self.0.read(RUN)? else { return Ok(None) };
        let path = self.0.path(RUN);
        serde_json::from_str(&text).map(Some).map_err(|why| {
            let remedy = "once no vehicle of the swarm flies, delete it";
            Error::Refused(format!("{}: not the note of a run: {why}; {remedy}", path.display()))
        })
    }

    /// Keeps a record in place of the one before.
    ///
    /// # Errors
    /// If it cannot be written.
    pub(crate) fn keep(&self, record: &Record) -> Result<(), Error> {
        self.0.write(RUN, &skein_lab::terminal::json(record))
    }

    /// Notes what an order means for that run, before it is given.
    ///
    /// # Errors
    /// As [`Self::note_end`].
    pub(crate) fn note_order(&self, verb: Verb) -> Result<(), Error> {
        match verb {
            Verb::Land | Verb::Abort => self.note_end(),
            Verb::Hold | Verb::Goto(_) => Ok(()),
        }
    }

    /// Notes that that run is over.
    ///
    /// # Errors
    /// As [`Self::read`] and [`Self::keep`].
    pub(crate) fn note_end(&self) -> Result<(), Error> {
        match self.read()? {
            Some(record) if !record.over => self.keep(&Record { over: true, ..record }),
            _ => Ok(()),
        }
    }
}
