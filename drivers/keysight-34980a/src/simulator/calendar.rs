//! The clock for the time stamps of readings. It runs on while power is off.

use std::time::Duration;

use chrono::{Datelike, NaiveDate};

/// A day, ms.
const DAY: u64 = 86_400_000;
/// The date that is shown for later ones, whose years do not fit four digits.
const LAST: NaiveDate = NaiveDate::from_ymd_opt(9999, 12, 31).unwrap();

/// Time of day and date, relative to their values at time zero.
#[derive(Debug)]
pub(crate) struct Calendar {
    /// Time since 1970-01-01 minus the instrument's time, ms.
    offset: i64,
}

impl Calendar {
    pub(crate) fn new(at_zero: Duration) -> Self {
        Self {
            offset: milliseconds(at_zero),
        }
    }

    fn shown(&self, at: Duration) -> u64 {
        // the sum is not negative: both setters below make it so at the time of setting, and time never decreases
        u64::try_from(self.offset + milliseconds(at)).unwrap_or(0)
    }

    pub(crate) fn set_date(&mut self, year: i32, month: u32, day: u32, at: Duration) {
        let time_of_day = self.shown(at) % DAY;
        // the command has a date from 1970 on
        let date = NaiveDate::from_ymd_opt(year, month, day).unwrap_or_default();
        let days = u64::try_from(date.to_epoch_days()).unwrap_or(0);
        self.set(days * DAY + time_of_day, at);
    }

    pub(crate) fn set_time(&mut self, hour: u32, minute: u32, second: f64, at: Duration) {
        let midnight = self.shown(at) / DAY * DAY;
        let whole = u64::from(hour * 3600 + minute * 60) * 1000;
        // At most 60 s.
        self.set(midnight + whole + (second * 1e3).round() as u64, at);
    }

    fn set(&mut self, shown: u64, at: Duration) {
        self.offset = shown as i64 - milliseconds(at);
    }

    /// `yyyy,mm,dd`.
    pub(crate) fn date(&self, at: Duration) -> String {
        let days = i32::try_from(self.shown(at) / DAY).unwrap_or(i32::MAX);
        let date = NaiveDate::from_epoch_days(days).map_or(LAST, |date| date.min(LAST));
        let (year, month, day) = (date.year(), date.month(), date.day());
        format!("{year:04},{month:02},{day:02}")
    }

    /// `hh,mm,ss.sss`.
    pub(crate) fn time(&self, at: Duration) -> String {
        let time = self.shown(at) % DAY;
        let (hours, minutes) = (time / 3_600_000, time / 60_000 % 60);
        let (seconds, thousandths) = (time / 1000 % 60, time % 1000);
        format!("{hours:02},{minutes:02},{seconds:02}.{thousandths:03}")
    }

    /// `yyyy,mm,dd,hh,mm,ss.sss`.
    pub(crate) fn stamp(&self, at: Duration) -> String {
        format!("{},{}", self.date(at), self.time(at))
    }
}

fn milliseconds(time: Duration) -> i64 {
    i64::try_from(time.as_millis()).unwrap_or(i64::MAX / 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_counted_there_and_back() {
        for (days, (year, month, day)) in [
            (0, (1970, 1, 1)),
            (10_957, (2000, 1, 1)),
            (11_016, (2000, 2, 29)),
            (20_778, (2026, 11, 21)),
        ] {
            let expected = format!("{year},{month:02},{day:02}");
            let at_zero = Duration::from_millis(days * DAY);
            assert_eq!(Calendar::new(at_zero).date(Duration::ZERO), expected);
            let mut calendar = Calendar::new(Duration::ZERO);
            calendar.set_date(year, month, day, Duration::ZERO);
            assert_eq!(calendar.offset, at_zero.as_millis() as i64);
        }
        let latest = Calendar::new(Duration::MAX);
        assert_eq!(latest.date(Duration::ZERO), "9999,12,31");
    }

    #[test]
    fn the_clock_goes_on_from_what_it_was_set_to() {
        let mut calendar = Calendar::new(Duration::ZERO);
        let at = Duration::from_millis(5250);
        calendar.set_date(2024, 2, 28, at);
        calendar.set_time(23, 59, 59.5, at);
        assert_eq!(calendar.stamp(at), "2024,02,28,23,59,59.500");
        assert_eq!(calendar.stamp(at * 2), "2024,02,29,00,00,04.750");
        calendar.set_time(23, 59, 60.0, at);
        assert_eq!(calendar.date(at), "2024,02,29");
    }
}
