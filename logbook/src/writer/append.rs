//! Appending frames: one transaction and one sync for each call.

use survey::{Frame, Quality, Reading};

use super::rows::{self, Unwritten};
use super::{SessionWriter, check_length, nanoseconds, span};
use crate::codec::MOST_FRAMES;
use crate::row::{FrameRow, Stretch, pack_trace};
use crate::{FrameRecord, LogbookError, MapRecord};

/// A frame, its map record, and its quality if it comes from another file.
type FrameToWrite<'a> = (&'a Frame, Option<&'a MapRecord>, Option<&'a Quality>);

impl SessionWriter {
    /// Writes a frame and returns its sequence, one more than the last one's; the frame's own number is ignored. When
    /// this returns, the frame is on disk.
    ///
    /// # Errors
    /// The wrong number of readings, a reading that is not finite, or a disk error. After an error nothing of the
    /// frame is in the file, and all earlier frames are.
    pub fn append(&mut self, frame: &Frame, map: Option<&MapRecord>) -> Result<u64, LogbookError> {
        self.append_all([(frame, map)])
    }

    /// Writes frames with one sync and returns the last one's sequence. A call is atomic: after a power cut either all
    /// of its frames are in the file or none.
    ///
    /// # Errors
    /// As [`SessionWriter::append`]; then no frame of this call is in the file.
    pub fn append_all<'a>(
        &mut self,
        frames: impl IntoIterator<Item = (&'a Frame, Option<&'a MapRecord>)>,
    ) -> Result<u64, LogbookError> {
        self.write_all(frames.into_iter().map(|(frame, map)| (frame, map, None)))
    }

    /// Writes frames read from another file, with their quality as recorded there.
    pub(crate) fn append_kept(&mut self, records: &[FrameRecord]) -> Result<u64, LogbookError> {
        let kept = records
            .iter()
            .map(|kept| (&kept.frame, kept.map.as_ref(), Some(&kept.quality)));
        self.write_all(kept)
    }

    /// Sets the sequence of the next frame; the frames in between are lost.
    pub(crate) fn skip_to(&mut self, sequence: u64) {
        self.sequence = sequence - 1;
    }

    fn write_all<'a>(
        &mut self,
        frames: impl Iterator<Item = FrameToWrite<'a>>,
    ) -> Result<u64, LogbookError> {
        self.check_usable()?;
        let before = (
            self.references.clone(),
            self.stretches.clone(),
            self.settings.clone(),
            self.mapper.clone(),
        );
        let written = self.write_frames(frames);
        if written.is_err() {
            (self.references, self.stretches, self.settings, self.mapper) = before;
        }
        let last = written?;
        self.frames += last - self.sequence;
        self.sequence = last;
        Ok(last)
    }

    fn write_frames<'a>(
        &mut self,
        frames: impl Iterator<Item = FrameToWrite<'a>>,
    ) -> Result<u64, LogbookError> {
        let wants = self.header.protocol.len();
        let mut sequence = self.sequence;
        let header_checksum = self.header_checksum;
        let frames: Vec<FrameToWrite<'a>> = frames.collect();
        let mut packed = None;
        let mut store = || -> Result<(), Unwritten> {
            let transaction = self.connection.transaction()?;
            for (index, (frame, map, quality)) in frames.iter().enumerate() {
                sequence += 1;
                let place = index % MOST_FRAMES;
                if place == 0 {
                    let together = &frames[index..frames.len().min(index + MOST_FRAMES)];
                    let readings = together.iter().map(|(frame, ..)| &*frame.readings);
                    let readings: Vec<&[Reading]> = readings.collect();
                    for readings in &readings {
                        check_length(readings.len(), wants)?;
                    }
                    let new = self.references.pack(&readings)?;
                    rows::write_reference(&transaction, header_checksum, &new)?;
                    packed = Some(new);
                }
                let packed = packed.take();
                let settings = rows::known_settings(
                    &transaction,
                    header_checksum,
                    &mut self.settings,
                    &frame.settings,
                )?;
                let mapper = match *map {
                    Some(map) => Some(rows::known_mapper(
                        &transaction,
                        header_checksum,
                        &mut self.mapper,
                        map,
                    )?),
                    None => None,
                };
                let new = Stretch {
                    // set if the frame begins it
                    id: 0,
                    period: 0,
                    sequence: sequence as i64,
                    monotonic: span(frame.monotonic, "a frame's monotonic time")? / 1000,
                    wall: nanoseconds(frame.wall, "a frame's wall time")?.div_euclid(1000),
                    settings,
                    mapper,
                    simulated: frame.simulated,
                };
                let stands = self.stretches.place(&transaction, header_checksum, new)?;
                let quality = match quality {
                    Some(kept) => (*kept).clone(),
                    None => self.checks.of(frame),
                };
                rows::write_frame(
                    &transaction,
                    header_checksum,
                    &FrameRow {
                        sequence: sequence as i64,
                        stretch: stands.stretch,
                        tick: stands.tick,
                        skew: stands.skew,
                        duration: span(frame.duration, "a frame's duration")? / 1000,
                        reference: packed.as_ref().and_then(|packed| packed.reference),
                        flags: rows::bits(&quality),
                        loop_sum: quality.loop_sum.filter(|worst| worst.is_finite()),
                        remarks: rows::remarks(&quality)?,
                        map_hash: map.map(pack_trace),
                        place: place as i64,
                        blob: packed.map(|packed| packed.blob),
                    },
                )?;
            }
            transaction.commit()?;
            Ok(())
        };
        match store() {
            // checked before anything is acknowledged: frames in a deleted file would be lost
            Ok(()) => self.check_written().map(|()| sequence),
            Err(Unwritten::Refused(refusal)) => Err(refusal),
            Err(Unwritten::Store(source)) => Err(self.write_failed("write a frame to", source)),
        }
    }
}
