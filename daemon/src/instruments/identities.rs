//! The expected instruments of a rig: those found when it was first assembled, or accepted by the operator since.
//!
//! They are stored in the record's directory, so that a replacement while no daemon was running is detected too.
//! Instruments with the same role and address are compared by serial number; changing the address in the configuration
//! counts as accepting the new instrument. Simulated instruments are defined by their profile, and are not stored.

use std::path::{Path, PathBuf};

use logbook::InstrumentRecord;
use outfile::Existing;
use serde::{Deserialize, Serialize};

/// In the directory of the record.
const FILE: &str = "known-instruments.json";
/// Every role an instrument can have.
pub(crate) const ROLES: [&str; 4] = ["source", "switch", "voltmeter", "switch+voltmeter"];

/// The required action of a user if another instrument is found.
pub(crate) const ACCEPT_HINT: &str =
    "nothing is measured with it until a person runs `tactus instruments accept`";

/// One instrument as found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Connected {
    pub role: &'static str,
    pub identity: String,
    pub address: String,
    pub simulated: bool,
}

impl Connected {
    /// Whether it is the same instrument: same role, vendor, model and serial number; the firmware may differ.
    pub(crate) fn is_same(&self, other: &Self) -> bool {
        let fields = |found: &Self| -> Vec<String> {
            let fields = found.identity.split(',').take(3);
            fields
                .map(|field| field.trim().to_ascii_uppercase())
                .collect()
        };
        self.role == other.role && fields(self) == fields(other)
    }

    /// The instrument among `others` with the same role and address.
    fn successor<'a>(&self, others: &'a [Self]) -> Option<&'a Self> {
        others
            .iter()
            .find(|other| other.role == self.role && other.address == self.address)
    }
}

/// The expected instruments and modules.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct ExpectedIdentities {
    pub instruments: Vec<Connected>,
    pub modules: Vec<String>,
    /// Modules with their serial numbers.
    pub cards: Vec<String>,
}

/// Why the expected instruments cannot be read.
#[derive(Debug, thiserror::Error)]
pub(crate) enum IdentitiesError {
    #[error("{} cannot be {attempt}; it lists the instruments of this rig", .path.display())]
    Io {
        path: PathBuf,
        attempt: &'static str,
        #[source]
        source: std::io::Error,
    },
    #[error(
        "{} is damaged: compare the instruments' serial numbers by hand, and remove it to accept those that are connected",
        .path.display()
    )]
    Damaged {
        path: PathBuf,
        #[source]
        source: serde_json::Error,
    },
}

/// The file format.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredIdentities {
    instruments: Vec<StoredInstrument>,
    cards: Vec<String>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredInstrument {
    role: String,
    identity: String,
    address: String,
}

impl ExpectedIdentities {
    /// The differences of `other`, as text for people; `None` for the same instruments. The firmware may change.
    pub(crate) fn differs(&self, other: &Self) -> Option<String> {
        let mut reported = Vec::new();
        for expected in &self.instruments {
            let Some(found) = expected.successor(&other.instruments) else {
                continue;
            };
            if !expected.is_same(found) {
                reported.push(format!(
                    "the {} at {} has been replaced: {} is expected, {} was found",
                    found.role, found.address, expected.identity, found.identity
                ));
            }
        }
        let mainframe = self.mainframe();
        if mainframe.is_some_and(|mainframe| mainframe.successor(&other.instruments).is_some()) {
            for (expected, found) in self.cards.iter().zip(&other.cards) {
                if expected != found {
                    reported.push(format!("{expected} is expected, {found} was found"));
                }
            }
        }
        (!reported.is_empty()).then(|| reported.join("; "))
    }

    /// Whether `found` is one of the expected instruments.
    pub(crate) fn has(&self, found: &Connected) -> bool {
        let there = std::slice::from_ref(found);
        self.instruments
            .iter()
            .filter(|expected| expected.successor(there).is_some())
            .all(|expected| expected.is_same(found))
    }

    /// Whether an instrument of a session's record is present in the same role, at any address.
    pub(crate) fn has_recorded(&self, then: &InstrumentRecord) -> bool {
        let mut here = self.instruments.iter();
        here.find(|found| found.role == then.role)
            .is_some_and(|now| {
                now.is_same(&Connected {
                    role: now.role,
                    identity: then.identity.clone(),
                    address: then.address.clone(),
                    simulated: now.simulated,
                })
            })
    }

    fn mainframe(&self) -> Option<&Connected> {
        self.instruments
            .iter()
            .find(|found| found.role.ends_with("voltmeter"))
    }

    /// The instruments expected by the last daemon; `None` if there was none.
    ///
    /// # Errors
    /// A file that cannot be read or has another format.
    pub(crate) fn recall(directory: &Path) -> Result<Option<Self>, IdentitiesError> {
        let path = directory.join(FILE);
        let text = match std::fs::read_to_string(&path) {
            Ok(text) => text,
            Err(source) if source.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(source) => {
                let attempt = "read";
                return Err(IdentitiesError::Io {
                    path,
                    attempt,
                    source,
                });
            }
        };
        let kept: StoredIdentities = serde_json::from_str(&text)
            .map_err(|source| IdentitiesError::Damaged { path, source })?;
        let instruments = kept.instruments.into_iter().filter_map(|kept| {
            Some(Connected {
                role: ROLES.into_iter().find(|role| *role == kept.role)?,
                identity: kept.identity,
                address: kept.address,
                simulated: false,
            })
        });
        Ok(Some(Self {
            instruments: instruments.collect(),
            modules: Vec::new(),
            cards: kept.cards,
        }))
    }

    /// Stores the real instruments for the next daemon. The file is replaced atomically.
    ///
    /// # Errors
    /// A disk error.
    pub(crate) fn keep(&self, directory: &Path) -> Result<(), IdentitiesError> {
        let real = self.instruments.iter().filter(|found| !found.simulated);
        let kept = StoredIdentities {
            instruments: real
                .map(|found| StoredInstrument {
                    role: found.role.to_owned(),
                    identity: found.identity.clone(),
                    address: found.address.clone(),
                })
                .collect(),
            cards: match self.mainframe() {
                Some(mainframe) if !mainframe.simulated => self.cards.clone(),
                _ => Vec::new(),
            },
        };
        if kept.instruments.is_empty() {
            return Ok(());
        }
        let path = directory.join(FILE);
        let fault = |source| IdentitiesError::Io {
            path: path.clone(),
            attempt: "written",
            source,
        };
        let text = serde_json::to_string_pretty(&kept).map_err(|fail| fault(fail.into()))?;
        outfile::write(&path, Existing::Replace, text.as_bytes())
            .map_err(|refusal| fault(refusal.into_io()))
    }
}

#[cfg(test)]
mod tests {
    use crate::instruments::identities::*;

    fn expected(serial: &str, address: &str, card: &str) -> ExpectedIdentities {
        let found = |role, identity: String| Connected {
            role,
            identity,
            address: address.to_owned(),
            simulated: false,
        };
        ExpectedIdentities {
            instruments: vec![
                found("source", format!("KEITHLEY,MODEL 6221,{serial},D04")),
                found("switch+voltmeter", "Agilent,34980A,MY1,2.43".to_owned()),
            ],
            modules: Vec::new(),
            cards: vec![format!("slot 1: {card}"), "slot 2: empty".to_owned()],
        }
    }

    #[test]
    fn identities_are_compared_by_serial_number_and_module() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(ExpectedIdentities::recall(folder.path()).unwrap(), None);
        let first = expected("1", "tcp:h:1", "34924A MY7");
        first.keep(folder.path()).unwrap();
        let recalled = ExpectedIdentities::recall(folder.path()).unwrap().unwrap();
        assert_eq!(recalled, first);
        assert_eq!(recalled.differs(&first), None);
        let firmware = |mut expected: ExpectedIdentities| {
            expected.instruments[0].identity = "KEITHLEY,MODEL 6221,1,D05".to_owned();
            expected
        };
        assert_eq!(recalled.differs(&firmware(first.clone())), None);

        let other = expected("2", "tcp:h:1", "34924A MY7");
        let reported = recalled.differs(&other).unwrap();
        assert!(
            reported.contains("6221,2,") && reported.contains("6221,1,"),
            "{reported}"
        );
        assert!(!recalled.has(&other.instruments[0]) && recalled.has(&other.instruments[1]));
        let module = recalled.differs(&expected("1", "tcp:h:1", "34924A MY8"));
        assert!(module.is_some_and(|reported| reported.contains("34924A MY8")));
        // a changed address in the configuration is accepted
        assert_eq!(recalled.differs(&expected("2", "tcp:h:9", "34931A")), None);
    }

    #[test]
    fn a_damaged_file_is_no_agreement_and_the_simulated_is_not_kept() {
        let folder = tempfile::tempdir().unwrap();
        let mut simulated = expected("1", "simulated", "34924A");
        for found in &mut simulated.instruments {
            found.simulated = true;
        }
        simulated.keep(folder.path()).unwrap();
        assert_eq!(ExpectedIdentities::recall(folder.path()).unwrap(), None);
        for text in ["", "{", "[]", r#"{"instruments":[{"role":1}],"cards":[]}"#] {
            std::fs::write(folder.path().join(FILE), text).unwrap();
            let refused = ExpectedIdentities::recall(folder.path()).unwrap_err();
            assert!(
                matches!(refused, IdentitiesError::Damaged { .. }),
                "{refused:?}"
            );
            assert!(refused.to_string().contains(FILE), "{refused}");
        }
    }
}
