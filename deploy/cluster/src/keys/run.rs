//! The record of the run that this PC began last: `run.json` in the folder of keys. It outlives the flight, so that no
//! host can pass off an old run as the current one.

use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};
use skein_agent::link::signature::runs::RunNote;
use skein_common::message::Verb;

use super::folder::Folder;
use crate::inventory::{Inventory, SecurityKind};
use skein_lab::error::Error;

/// Name of the file.
pub(crate) const RUN: &str = "run.json";

/// The newest run that was begun or joined from this PC.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Record {
    pub(crate) note: RunNote,
    /// Whether the run is over and must not be joined again because of this record: all its vehicles are known to have
    /// ended, or a signed order to land or to abort exists, which would land every vehicle that is started in it.
    pub(crate) over: bool,
}

impl Record {
    pub(crate) fn of(note: RunNote) -> Self {
        Self { note, over: false }
    }
}

/// The file of the record.
#[derive(Clone, Debug)]
pub struct RunFile(Folder);

impl RunFile {
    pub(crate) fn of(inventory: &Inventory) -> Option<Self> {
        (inventory.security == SecurityKind::Tls).then(|| Self(Folder(inventory.keys.clone())))
    }

    /// Reads the record of the run that this PC began last; `None` if the file does not exist.
    ///
    /// # Errors
    /// If the file cannot be read or is not valid.
    pub(crate) fn read(&self) -> Result<Option<Record>, Error> {
        let Some(text) = self.0.read(RUN)? else { return Ok(None) };
        let path = self.0.path(RUN);
        serde_json::from_str(&text).map(Some).map_err(|why| {
            let remedy = "once no vehicle of the swarm flies, delete it";
            Error::Refused(format!("{}: not the record of a run: {why}; {remedy}", path.display()))
        })
    }

    /// Replaces the record.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub(crate) fn keep(&self, record: &Record) -> Result<(), Error> {
        self.0.write(RUN, &skein_lab::terminal::json(record))
    }

    /// Records that an order ends the run, before it is sent.
    ///
    /// # Errors
    /// The errors of [`Self::note_end`].
    pub(crate) fn note_order(&self, verb: Verb) -> Result<(), Error> {
        match verb {
            Verb::Land | Verb::Abort => self.note_end(),
            Verb::Hold | Verb::Goto(_) | Verb::Release | Verb::Set(_) => Ok(()),
        }
    }

    /// Records that the run is over.
    ///
    /// # Errors
    /// The errors of [`Self::read`] and [`Self::keep`].
    pub(crate) fn note_end(&self) -> Result<(), Error> {
        // The teams of a fleet are ordered at once, each by a thread.
        static WRITING: Mutex<()> = Mutex::new(());
        let _only = WRITING.lock().unwrap_or_else(PoisonError::into_inner);
        match self.read()? {
            Some(record) if !record.over => self.keep(&Record { over: true, ..record }),
            _ => Ok(()),
        }
    }
}
