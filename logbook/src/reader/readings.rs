//! Readings of frames: blobs shared by one or more frames, and the references from which they differ.

use survey::Reading;

use super::SessionReader;
use crate::LogbookError;
use crate::codec::{self, Reference};
use crate::row::{FrameRow, reference_checksum};

/// Cache for the readings of the next frame.
#[derive(Debug, Default)]
pub(super) struct ReadingsCache {
    reference: Option<(i64, Reference)>,
    /// Frames of one blob, and the number of the row that holds it.
    block: Option<(i64, Vec<Vec<Reading>>)>,
}

impl SessionReader {
    /// A frame's readings, from its own row's blob or from an earlier row's, which is verified in the same way.
    pub(super) fn readings(
        &self,
        row: &FrameRow,
        known: &mut ReadingsCache,
    ) -> Result<Vec<Reading>, LogbookError> {
        let holder = row.sequence.wrapping_sub(row.place);
        let damaged = |why: &str| {
            let number = row.sequence;
            let held = format!("frame {number}, whose readings are stored with frame {holder}");
            self.damaged(held, why)
        };
        let place = usize::try_from(row.place).ok();
        let place = place.filter(|place| *place < codec::MOST_FRAMES);
        let place =
            place.ok_or_else(|| damaged("that frame cannot have been written together with it"))?;
        if known.block.as_ref().is_none_or(|(of, _)| *of != holder) {
            known.block = None;
            let block = if place == 0 {
                self.block(row, known)?
            } else {
                let stored = u64::try_from(holder)
                    .ok()
                    .and_then(|holder| self.row(holder).transpose())
                    .transpose()?
                    .ok_or_else(|| damaged("that frame is not there"))?;
                if stored.checksum != stored.row.checksum(self.header_checksum) {
                    return Err(damaged("the checksum of that frame does not agree"));
                }
                self.block(&stored.row, known)?
            };
            known.block = Some((holder, block));
        }
        let block = known.block.as_ref().map(|(_, block)| block);
        let readings = block.and_then(|block| block.get(place));
        readings
            .cloned()
            .ok_or_else(|| damaged("its readings are not among them"))
    }

    /// The frames of a row's blob.
    fn block(
        &self,
        row: &FrameRow,
        known: &mut ReadingsCache,
    ) -> Result<Vec<Vec<Reading>>, LogbookError> {
        let place = || format!("frame {}", row.sequence);
        let (0, Some(blob)) = (row.place, &row.blob) else {
            return Err(self.damaged(place(), "it holds no readings"));
        };
        if let Some(reference) = row.reference
            && known
                .reference
                .as_ref()
                .is_none_or(|(id, _)| *id != reference)
        {
            known.reference = Some((reference, self.reference(row.sequence, reference)?));
        }
        let reference = match (row.reference, &known.reference) {
            (Some(_), Some((_, reference))) => reference,
            _ => &Reference::NONE,
        };
        codec::decode(blob, reference, self.header.protocol.len())
            .map_err(|cause| self.damaged(place(), cause.to_string()))
    }

    /// A blob that holds the readings of one frame.
    pub(super) fn decode_one(
        &self,
        blob: &[u8],
        reference: &Reference,
    ) -> Result<Vec<Reading>, codec::DecodeError> {
        let mut frames = codec::decode(blob, reference, self.header.protocol.len())?;
        match (frames.pop(), frames.is_empty()) {
            (Some(readings), true) => Ok(readings),
            _ => Err(codec::DecodeError::of("it holds several frames")),
        }
    }

    /// The reference of a frame's differences.
    pub(super) fn reference(&self, of: i64, reference: i64) -> Result<Reference, LogbookError> {
        if reference == 0 {
            return self.baseline_reference(&format!("frame {of}"));
        }
        let place = format!("reference {reference}, which frame {of} refers to");
        let sql = "SELECT against_baseline, readings, checksum FROM reference WHERE id = ?1";
        let row = self.one_row(sql, [reference], "read a reference of", |row| {
            Ok((row.get::<_, bool>(0)?, row.get(1)?, row.get(2)?))
        })?;
        let Some((against_baseline, blob, checksum)): Option<(_, Vec<u8>, Vec<u8>)> = row else {
            return Err(self.damaged(place, "it is not there"));
        };
        if checksum != reference_checksum(self.header_checksum, reference, against_baseline, &blob)
        {
            return Err(self.damaged(place, "its checksum does not agree"));
        }
        let against = if against_baseline {
            self.baseline_reference(&place)?
        } else {
            Reference::NONE
        };
        let readings = self
            .decode_one(&blob, &against)
            .map_err(|cause| self.damaged(place, cause.to_string()))?;
        Ok(Reference::new(&readings))
    }

    fn baseline_reference(&self, of: &str) -> Result<Reference, LogbookError> {
        let baseline = self.baseline()?.ok_or_else(|| {
            self.damaged(of.to_owned(), "it refers to a baseline, and there is none")
        })?;
        Ok(Reference::new(&baseline.readings))
    }
}
