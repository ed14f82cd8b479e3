//! The clock for the time stamps of readings. It runs on while power is off.

use std::time::Duration;

const DAY: u64 = 86_400;

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
        let time_of_day = self.shown(at) % (DAY * 1000);
        let days = days_before(year, month, day);
        self.set(days * DAY * 1000 + time_of_day, at);
    }

    pub(crate) fn set_time(&mut self, hour: u32, minute: u32, second: f64, at: Duration) {
        let midnight = self.shown(at) / (DAY * 1000) * (DAY * 1000);
        let whole = u64::from(hour * 3600 + minute * 60) * 1000;
        // At most 60 s.
        self.set(midnight + whole + (second * 1e3).round() as u64, at);
    }

    fn set(&mut self, shown: u64, at: Duration) {
        self.offset = shown as i64 - milliseconds(at);
    }

    /// `yyyy,mm,dd`.
    pub(crate) fn date(&self, at: Duration) -> String {
        let (year, month, day) = date(self.shown(at) / (DAY * 1000));
        format!("{year:04},{month:02},{day:02}")
    }

    /// `hh,mm,ss.sss`.
    pub(crate) fn time(&self, at: Duration) -> String {
        let time = self.shown(at) % (DAY * 1000);
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

fn is_leap(year: u64) -> bool {
    year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400))
}

fn days_in_year(year: u64) -> u64 {
    if is_leap(year) { 366 } else { 365 }
}

fn days_in_month(year: u64, month: u64) -> u64 {
    match month {
        4 | 6 | 9 | 11 => 30,
        2 if is_leap(year) => 29,
        2 => 28,
        _ => 31,
    }
}

/// Days from 1970-01-01 to a date between 1970 and 2099.
fn days_before(year: i32, month: u32, day: u32) -> u64 {
    let year = u64::try_from(year).unwrap_or(1970);
    let years: u64 = (1970..year).map(days_in_year).sum();
    let months: u64 = (1..u64::from(month)).map(|m| days_in_month(year, m)).sum();
    years + months + u64::from(day.saturating_sub(1))
}

/// The date this number of days after 1970-01-01. Years beyond 9999 do not fit their four digits and are shown as 9999.
fn date(mut days: u64) -> (u64, u64, u64) {
    let mut year = 1970;
    while days >= days_in_year(year) {
        days -= days_in_year(year);
        year += 1;
        if year > 9999 {
            return (9999, 12, 31);
        }
    }
    let mut month = 1;
    while days >= days_in_month(year, month) {
        days -= days_in_month(year, month);
        month += 1;
    }
    (year, month, days + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_are_counted_there_and_back() {
        for (days, expected) in [
            (0, (1970, 1, 1)),
            (10_957, (2000, 1, 1)),
            (11_016, (2000, 2, 29)),
            (20_778, (2026, 11, 21)),
        ] {
            assert_eq!(date(days), expected);
            let (year, month, day) = expected;
            assert_eq!(days_before(year as i32, month as u32, day as u32), days);
        }
        assert_eq!(date(u64::MAX), (9999, 12, 31));
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
