//! Writes frames of a scene as a session of the logbook, in the daemon's format.

use std::path::Path;
use std::time::Duration;

use chrono::{DateTime, TimeDelta, Utc};
use logbook::{LogbookError, SessionHeader, SessionWriter};
use phantom::{Scan, Scene};
use survey::{Baseline, Frame, Precautions, Reading, Settings, Volts};

use studies::Failure;

/// Number of frames that are written to disk together.
const TOGETHER: usize = 64;

/// A session that is being written.
pub(super) struct Session {
    writer: SessionWriter,
    started: DateTime<Utc>,
    settings: Settings,
    lasts: Duration,
    waiting: Vec<Frame>,
    last: DateTime<Utc>,
}

fn failed(fault: &LogbookError) -> Failure {
    Failure::of("cannot write the session", fault)
}

impl Session {
    /// Creates a session named after the scene and its seed. Its time line begins with the year 2000: no clock is read,
    /// so that equal scenes give equal records. `config_toml`: the configuration to store with it.
    pub(super) fn create(
        folder: &Path,
        scene: &Scene,
        scan: &Scan,
        config_toml: String,
    ) -> Result<Self, Failure> {
        let name: String = (scene.name.to_lowercase().chars())
            .map(|letter| {
                if letter.is_ascii_alphanumeric() {
                    letter
                } else {
                    '_'
                }
            })
            .collect();
        let started = DateTime::UNIX_EPOCH + Duration::from_secs(10_957 * 86_400);
        let header = SessionHeader {
            seed: Some(scene.seed),
            simulated: true,
            config_toml,
            build: concat!("tactus-lab ", env!("CARGO_PKG_VERSION")).to_owned(),
            note: format!(
                "scene '{}', directly from the simulated sheet, in virtual time that begins with the year 2000",
                scene.name
            ),
            ..SessionHeader::new(
                format!("scene_{name}_{}", scene.seed),
                started,
                scan.protocol.clone(),
            )
        };
        Ok(Self {
            writer: SessionWriter::create(folder, &header).map_err(|fault| failed(&fault))?,
            started,
            settings: Settings {
                protocol_hash: scan.protocol.hash(),
                current: scan.current,
                range: scan.range,
                nplc: scan.nplc,
                settle: scan.settle,
                wiring: "none: directly from the sheet".to_owned(),
                precautions: Precautions::default(),
            },
            lasts: scan.frame_time(),
            waiting: Vec::new(),
            last: started,
        })
    }

    /// Adds a frame. The first one is the baseline.
    pub(super) fn put(&mut self, begin: Duration, readings: &[Volts]) -> Result<(), Failure> {
        let wall = self.started + TimeDelta::from_std(begin).unwrap_or(TimeDelta::MAX);
        let frame = Frame {
            sequence: 0,
            readings: readings.iter().map(|volts| Reading::Ok(*volts)).collect(),
            extra: Vec::new(),
            monotonic: begin,
            wall,
            duration: self.lasts,
            settings: self.settings.clone(),
            compliance: Vec::new(),
            simulated: true,
        };
        if begin.is_zero() {
            let baseline = Baseline::from_frames("first_frame", &[frame])
                .map_err(|fault| Failure::of("no baseline", &fault))?;
            return self
                .writer
                .baseline(&baseline)
                .map_err(|fault| failed(&fault));
        }
        self.last = wall;
        self.waiting.push(frame);
        if self.waiting.len() == TOGETHER {
            self.write()?;
        }
        Ok(())
    }

    fn write(&mut self) -> Result<(), Failure> {
        let frames = self.waiting.iter().map(|frame| (frame, None));
        self.writer
            .append_all(frames)
            .map_err(|fault| failed(&fault))?;
        self.waiting.clear();
        Ok(())
    }

    /// Closes the session and returns its path.
    pub(super) fn end(mut self) -> Result<String, Failure> {
        self.write()?;
        let place = self.writer.path().display().to_string();
        self.writer
            .close(self.last, "the scene's last frame")
            .map_err(|fault| failed(&fault))?;
        Ok(place)
    }
}
