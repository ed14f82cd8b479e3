//! Archives what is missing: closed parts of a record, and new lines of quantities.
//!
//! The catalogue is queried in each pass; the cached state only avoids reading files again.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::time::SystemTime;

use chrono::{DateTime, Utc};
use logbook::{ArchiveReceipt, Index, LogbookError, QuantityLine, quantities_file};
use serde::Serialize;

use crate::catalogue::{Catalogue, CatalogueError};
use crate::part::Part;
use crate::store::{Store, StoreError};

/// Site and machine of a record.
#[derive(Debug, Clone)]
pub struct Owner {
    /// The site.
    pub site: String,
    /// The machine.
    pub daq: String,
}

/// Result for a part or for the quantities of a session.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(tag = "what", rename_all = "kebab-case")]
pub enum Step {
    /// The part was archived.
    Archived {
        /// The part.
        part: String,
        /// Its name in the store.
        stored_as: String,
        /// Size, bytes.
        bytes: u64,
        /// Frames in it.
        frames: u64,
    },
    /// The part was archived before; its missing receipt was written.
    Receipt {
        /// The part.
        part: String,
    },
    /// Lines of quantities were added.
    Quantities {
        /// The session.
        session: String,
        /// How many.
        lines: u64,
    },
    /// A part is not archived, or has no receipt; the other parts are not affected.
    Problem {
        /// The part or file.
        part: String,
        /// What is wrong, and what to do.
        text: String,
    },
}

/// Why a whole pass ended.
#[derive(Debug, thiserror::Error)]
pub enum UploadError {
    /// The record cannot be read.
    #[error(transparent)]
    Record(#[from] LogbookError),
    /// The store refuses.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The catalogue refuses.
    #[error(transparent)]
    Catalogue(#[from] CatalogueError),
}

impl UploadError {
    /// Whether a retry may succeed without a change of the configuration.
    pub fn is_temporary(&self) -> bool {
        match self {
            Self::Record(_) => true,
            Self::Store(error) => error.is_temporary(),
            Self::Catalogue(error) => error.is_temporary(),
        }
    }
}

/// Comparison of record and archive.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Status {
    /// Closed parts of the record.
    pub closed: usize,
    /// Those of them that are in the catalogue.
    pub archived: usize,
    /// Ids of those that are missing in the catalogue.
    pub missing: Vec<String>,
    /// Open parts: of sessions being recorded, or that were not closed.
    pub open: usize,
    /// Lines of quantities that are missing in the catalogue.
    pub missing_lines: u64,
}

/// Size and time of a file of quantities.
type Stamp = (u64, SystemTime);

/// The uploader of one record.
#[derive(Debug)]
pub struct Uploader {
    folder: PathBuf,
    owner: Owner,
    index: Index,
    /// Files of quantities that are completely in the catalogue, with the number of their last line.
    complete: BTreeMap<String, (Stamp, u64)>,
}

/// A closed part of the record.
struct Closed {
    id: String,
    session: String,
    path: PathBuf,
}

impl Uploader {
    /// The uploader of the record in a folder.
    pub fn new(folder: impl Into<PathBuf>, owner: Owner) -> Self {
        let folder = folder.into();
        Self {
            index: Index::load(&folder),
            folder,
            owner,
            complete: BTreeMap::new(),
        }
    }

    /// Compares the record with the catalogue; changes nothing. Files that cannot be read are reported as in
    /// [`Uploader::pass`] and left out.
    ///
    /// # Errors
    /// The record cannot be listed, or the catalogue refuses.
    pub async fn status(
        &mut self,
        catalogue: &Catalogue,
        report: &mut dyn FnMut(Step),
    ) -> Result<Status, UploadError> {
        let (closed, sessions, open) = self.listed(report)?;
        let known = self.known_parts(catalogue, &closed).await?;
        let mut there = self.known_lines(catalogue, &sessions).await?;
        let mut missing_lines = 0;
        for session in &sessions {
            match self.new_lines(session, &mut there) {
                Ok(lines) => missing_lines += lines.len() as u64,
                Err(error) => report(self.unread(session, &error)),
            }
        }
        let missing = closed
            .iter()
            .filter(|part| !known.contains_key(&part.id))
            .map(|part| part.id.clone())
            .collect();
        Ok(Status {
            closed: closed.len(),
            archived: known.len(),
            missing,
            open,
            missing_lines,
        })
    }

    /// Archives everything that is missing, oldest first; reports each step. A damaged part, and quantities that
    /// cannot be read, are reported and do not delay the others.
    ///
    /// # Errors
    /// Store or catalogue refuse; what was done before stays, and the next pass continues.
    pub async fn pass(
        &mut self,
        store: &dyn Store,
        catalogue: &mut Catalogue,
        report: &mut dyn FnMut(Step),
    ) -> Result<(), UploadError> {
        let (closed, sessions, _) = self.listed(report)?;
        let mut known = self.known_parts(catalogue, &closed).await?;
        let mut there = self.known_lines(catalogue, &sessions).await?;
        let mut unread = BTreeSet::new();
        for part in &closed {
            if known.contains_key(&part.id) {
                continue;
            }
            match self.push(part, store, catalogue, &mut there).await? {
                Ok(stored) => {
                    known.insert(part.id.clone(), stored.name.sha256.clone());
                    report(Step::Archived {
                        part: part.id.clone(),
                        stored_as: stored.name.to_string(),
                        bytes: stored.bytes,
                        frames: stored.frames,
                    });
                }
                Err(text) => report(problem(part, text)),
            }
        }
        for session in &sessions {
            let lines = match self.new_lines(session, &mut there) {
                Ok(lines) => lines,
                Err(error) => {
                    report(self.unread(session, &error));
                    unread.insert(session.clone());
                    continue;
                }
            };
            if lines.is_empty() {
                continue;
            }
            let Owner { site, daq } = &self.owner;
            catalogue.enter_lines(site, daq, session, &lines).await?;
            there.insert(session.clone(), lines.last().map_or(0, |line| line.number));
            report(Step::Quantities {
                session: session.clone(),
                lines: lines.len() as u64,
            });
        }
        let first = first_parts(&closed);
        for part in &closed {
            let Some(sha256) = known.get(&part.id) else {
                continue;
            };
            // the receipt of the first existing part also covers the quantities of its session
            let is_first = first.get(part.session.as_str()) == Some(&part.id.as_str());
            if is_first && unread.contains(&part.session) {
                continue;
            }
            let lines = there.get(&part.session).filter(|_| is_first);
            match self.confirm(part, sha256, lines.copied().unwrap_or_default()) {
                Ok(false) => {}
                Ok(true) => report(Step::Receipt {
                    part: part.id.clone(),
                }),
                Err(text) => report(problem(part, text)),
            }
        }
        Ok(())
    }

    /// The closed parts, the sessions of all parts, and the number of open parts. Reports files that cannot be read.
    fn listed(
        &mut self,
        report: &mut dyn FnMut(Step),
    ) -> Result<(Vec<Closed>, Vec<String>, usize), UploadError> {
        self.index.refresh()?;
        for file in self.index.unreadable() {
            report(Step::Problem {
                part: file.path.display().to_string(),
                text: survey::error_chain(&*file.why),
            });
        }
        let (mut closed, mut sessions, mut open) = (Vec::new(), BTreeSet::new(), 0);
        for found in self.index.sessions() {
            // a copy under another name
            if found
                .path
                .file_stem()
                .is_none_or(|stem| stem != found.id.as_str())
            {
                continue;
            }
            sessions.insert(found.session().to_owned());
            match found.closed {
                Some(_) => closed.push(Closed {
                    id: found.id.clone(),
                    session: found.session().to_owned(),
                    path: found.path.clone(),
                }),
                None => open += 1,
            }
        }
        Ok((closed, sessions.into_iter().collect(), open))
    }

    /// The problem of a session whose quantities cannot be read.
    fn unread(&self, session: &str, error: &LogbookError) -> Step {
        Step::Problem {
            part: quantities_file(&self.folder, session).display().to_string(),
            text: survey::error_chain(error),
        }
    }

    async fn known_parts(
        &self,
        catalogue: &Catalogue,
        closed: &[Closed],
    ) -> Result<BTreeMap<String, String>, CatalogueError> {
        let ids: Vec<&str> = closed.iter().map(|part| part.id.as_str()).collect();
        catalogue
            .known_parts(&self.owner.site, &self.owner.daq, &ids)
            .await
    }

    async fn known_lines(
        &self,
        catalogue: &Catalogue,
        sessions: &[String],
    ) -> Result<BTreeMap<String, u64>, CatalogueError> {
        let names: Vec<&str> = sessions.iter().map(String::as_str).collect();
        catalogue
            .known_lines(&self.owner.site, &self.owner.daq, &names)
            .await
    }

    /// Archives one part with its events, and the quantities of its session. The inner error concerns only this part.
    async fn push(
        &mut self,
        part: &Closed,
        store: &dyn Store,
        catalogue: &mut Catalogue,
        there: &mut BTreeMap<String, u64>,
    ) -> Result<Result<Part, String>, UploadError> {
        let mut read = match Part::read(&part.path, &self.owner.site, &self.owner.daq) {
            Ok(read) => read,
            Err(error) => return Ok(Err(survey::error_chain(&error))),
        };
        match store.put(&read.name, &mut read.file) {
            Ok(_) => {}
            Err(error) if error.is_of_one_part() => {
                return Ok(Err(survey::error_chain(&error)));
            }
            Err(error) => return Err(error.into()),
        }
        // unreadable lines are reported once for the session, after its parts are archived
        let lines = self.new_lines(&part.session, there).unwrap_or_default();
        match catalogue.enter(&read, &lines).await {
            Ok(()) => {}
            Err(error @ CatalogueError::Conflict { .. }) => return Ok(Err(error.to_string())),
            Err(error) => return Err(error.into()),
        }
        if let Some(last) = lines.last() {
            there.insert(part.session.clone(), last.number);
        }
        Ok(Ok(read))
    }

    /// The lines of quantities that are missing in the catalogue. Caches which files are complete there.
    fn new_lines(
        &mut self,
        session: &str,
        there: &mut BTreeMap<String, u64>,
    ) -> Result<Vec<QuantityLine>, LogbookError> {
        let known = there.get(session).copied().unwrap_or_default();
        let file = quantities_file(&self.folder, session);
        let stamp = std::fs::metadata(file)
            .and_then(|found| Ok((found.len(), found.modified()?)))
            .ok();
        let Some(stamp) = stamp else {
            return Ok(Vec::new());
        };
        if self.complete.get(session) == Some(&(stamp, known)) {
            return Ok(Vec::new());
        }
        let found = logbook::quantity_lines(&self.folder, session)?;
        let mut lines = found.map(|found| found.lines).unwrap_or_default();
        lines.retain(|line| line.number > known);
        if lines.is_empty() {
            self.complete.insert(session.to_owned(), (stamp, known));
        }
        Ok(lines)
    }

    /// Writes the receipt of an archived part, unless it exists and covers these lines of quantities; returns whether
    /// it was written. If there is no receipt of the present file, the part is read.
    fn confirm(&self, part: &Closed, sha256: &str, lines: u64) -> Result<bool, String> {
        let found = std::fs::metadata(&part.path).map_err(|error| error.to_string())?;
        let modified: DateTime<Utc> = found.modified().map_err(|error| error.to_string())?.into();
        let of_this_file = logbook::receipt(&part.path).filter(|receipt| {
            receipt.sha256 == sha256 && receipt.bytes == found.len() && modified <= receipt.at
        });
        let receipt = match of_this_file {
            Some(receipt) if receipt.quantity_lines >= lines => return Ok(false),
            Some(receipt) => ArchiveReceipt {
                quantity_lines: lines,
                ..receipt
            },
            None => self.compared(part, sha256, modified, lines)?,
        };
        logbook::mark_archived(&part.path, &receipt).map_err(|error| {
            format!(
                "is archived, but its receipt cannot be written: {}",
                survey::error_chain(&error)
            )
        })?;
        Ok(true)
    }

    /// The receipt of a part, after comparing its content with the archive.
    fn compared(
        &self,
        part: &Closed,
        sha256: &str,
        modified: DateTime<Utc>,
        lines: u64,
    ) -> Result<ArchiveReceipt, String> {
        let read = Part::read(&part.path, &self.owner.site, &self.owner.daq)
            .map_err(|error| survey::error_chain(&error))?;
        if read.name.sha256 != sha256 {
            let conflict = CatalogueError::Conflict {
                part: part.id.clone(),
                site: self.owner.site.clone(),
                daq: self.owner.daq.clone(),
                archived: sha256.to_owned(),
                found: read.name.sha256,
            };
            return Err(conflict.to_string());
        }
        Ok(ArchiveReceipt {
            // if the clock was set back, the modification time is in the future; the receipt is nevertheless valid
            // for the present file
            at: Utc::now().max(modified),
            sha256: sha256.to_owned(),
            bytes: read.bytes,
            stored_as: read.name.to_string(),
            quantity_lines: lines,
        })
    }
}

/// The first existing part of each session.
fn first_parts(closed: &[Closed]) -> BTreeMap<&str, &str> {
    let number = |id: &str| logbook::part_of(id).1;
    let mut first: BTreeMap<&str, &str> = BTreeMap::new();
    for Closed { id, session, .. } in closed {
        let known = first.entry(session).or_insert(id);
        if number(id) < number(known) {
            *known = id;
        }
    }
    first
}

fn problem(part: &Closed, text: String) -> Step {
    Step::Problem {
        part: part.id.clone(),
        text,
    }
}

#[cfg(test)]
mod tests;
