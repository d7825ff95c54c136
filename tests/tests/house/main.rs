//! Rules for the sources themselves.
#![expect(clippy::unwrap_used, reason = "what a test cannot do has failed")]

mod docstrings;
mod house;
mod plain_words;
mod plants;
