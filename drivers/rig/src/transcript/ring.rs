//! Recent messages to and from a rig's instruments, kept in memory for analysing failed frames.
//!
//! A ring transcript holds the *opening* (the messages from connecting to the read-back of the settings) and the last
//! frames. A frame's messages after its opening are a complete conversation, which `tactus-sim replay` can send to
//! simulated instruments that were just switched on.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::time::Instant;

use crate::transcript::{Entry, EntryContent};

/// Maximum number of entries of one frame, ten times the number in a frame with 598 messages; beyond it the oldest
/// entries are dropped and counted.
const LONGEST_TRANSCRIPT: usize = 16 * 1024;

/// A transcript that every link of a rig writes to. A handle: clones write to the same transcript.
#[derive(Debug, Clone)]
pub struct RingTranscript(Arc<Mutex<RingState>>);

#[derive(Debug)]
struct RingState {
    begun: Instant,
    most: usize,
    opening: Arc<Vec<Entry>>,
    /// Whether the opening is still in progress.
    opens: bool,
    transcripts: VecDeque<Transcript>,
}

/// The messages of one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Transcript {
    /// Number of the frame, from 1 since the transcript was begun.
    pub number: u64,
    /// The messages from connecting to the read-back of the settings.
    pub opening: Arc<Vec<Entry>>,
    /// The messages of this frame after the opening.
    pub entries: Vec<Entry>,
    /// Number of entries dropped at its beginning.
    pub lost: u64,
}

impl Transcript {
    /// The whole conversation, in its order.
    pub fn conversation(&self) -> impl Iterator<Item = &Entry> {
        self.opening.iter().chain(&self.entries)
    }

    fn push(&mut self, entry: Entry) {
        if self.entries.len() >= LONGEST_TRANSCRIPT {
            self.entries.remove(0);
            self.lost += 1;
        }
        self.entries.push(entry);
    }
}

impl RingTranscript {
    /// An empty transcript that keeps the last `transcripts` frames; 0 keeps only the current frame.
    pub fn new(transcripts: usize) -> Self {
        Self(Arc::new(Mutex::new(RingState {
            begun: Instant::now(),
            most: transcripts.max(1),
            opening: Arc::default(),
            opens: true,
            transcripts: VecDeque::new(),
        })))
    }

    /// Starts a new opening: instruments are connected and set up. Earlier frames keep their opening.
    pub fn open(&self) {
        let mut held = self.lock();
        held.opening = Arc::default();
        held.opens = true;
    }

    /// Starts a frame. Returns its number.
    pub fn next_transcript(&self) -> u64 {
        let mut held = self.lock();
        let number = held
            .transcripts
            .back()
            .map_or(1, |transcript| transcript.number + 1);
        held.opens = false;
        let opening = Arc::clone(&held.opening);
        held.transcripts.push_back(Transcript {
            number,
            opening,
            entries: Vec::new(),
            lost: 0,
        });
        while held.transcripts.len() > held.most {
            held.transcripts.pop_front();
        }
        number
    }

    /// Changes the number of frames kept.
    pub fn keep(&self, transcripts: usize) {
        self.lock().most = transcripts.max(1);
    }

    /// The frames kept, oldest first.
    pub fn transcripts(&self) -> Vec<Transcript> {
        self.lock().transcripts.iter().cloned().collect()
    }

    /// The entries of the last opening, if no frame has started since.
    pub fn opening(&self) -> Vec<Entry> {
        self.lock().opening.to_vec()
    }

    /// Appends an entry.
    pub fn write(&self, instrument: &str, content: EntryContent) {
        let mut held = self.lock();
        let entry = Entry {
            t_s: held.begun.elapsed().as_secs_f64(),
            instrument: instrument.to_owned(),
            content,
        };
        if held.opens {
            let opening = Arc::make_mut(&mut held.opening);
            if opening.len() < LONGEST_TRANSCRIPT {
                opening.push(entry);
            }
        } else if let Some(transcript) = held.transcripts.back_mut() {
            transcript.push(entry);
        }
    }

    fn lock(&self) -> MutexGuard<'_, RingState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use crate::transcript::ring::*;

    fn content(transcript: &Transcript) -> Vec<String> {
        transcript
            .conversation()
            .map(|entry| match &entry.content {
                EntryContent::Sent(text)
                | EntryContent::Received(text)
                | EntryContent::Note(text) => text.clone(),
            })
            .collect()
    }

    #[test]
    fn a_frame_has_its_own_opening_and_the_oldest_is_dropped() {
        let transcript = RingTranscript::new(2);
        let say = |text: &str| transcript.write("6221", EntryContent::Sent(text.to_owned()));
        say("opening");
        assert_eq!(transcript.opening().len(), 1);
        for frame in ["one", "two"] {
            transcript.next_transcript();
            say(frame);
        }
        transcript.open();
        say("opening again");
        assert_eq!(transcript.next_transcript(), 3);
        say("three");
        let transcripts = transcript.transcripts();
        assert_eq!(transcripts.len(), 2);
        assert_eq!((transcripts[0].number, transcripts[1].number), (2, 3));
        assert_eq!(content(&transcripts[0]), ["opening", "two"]);
        assert_eq!(content(&transcripts[1]), ["opening again", "three"]);
        let times: Vec<f64> = transcripts[1]
            .conversation()
            .map(|entry| entry.t_s)
            .collect();
        assert!(times.is_sorted() && times[0] >= 0.0);
    }

    #[test]
    fn a_frame_that_is_too_long_loses_its_beginning_with_a_note() {
        let transcript = RingTranscript::new(0);
        transcript.next_transcript();
        for number in 0..LONGEST_TRANSCRIPT + 3 {
            transcript.write("board", EntryContent::Received(number.to_string()));
        }
        let transcript = transcript.transcripts().remove(0);
        assert_eq!(
            (transcript.lost, transcript.entries.len()),
            (3, LONGEST_TRANSCRIPT)
        );
        assert_eq!(
            transcript.entries[0].content,
            EntryContent::Received("3".to_owned())
        );
    }
}
