//! Survey dates: whole days, written `YYYY-MM-DD`.

use super::{Error, Result};

/// A day of the proleptic Gregorian calendar.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Date {
    pub year: i32,
    pub month: u8,
    pub day: u8,
}

impl Date {
    /// Reads `YYYY-MM-DD`; refuses days that do not exist.
    pub fn parse(text: &str) -> Result<Date> {
        let bad = || Error::invalid("date", format!("'{text}' is not a day written as YYYY-MM-DD"));
        let mut it = text.split('-');
        let (y, m, d) = (it.next().ok_or_else(bad)?, it.next().ok_or_else(bad)?, it.next().ok_or_else(bad)?);
        if it.next().is_some() || y.len() != 4 || m.len() != 2 || d.len() != 2 {
            return Err(bad());
        }
        let year: i32 = y.parse().map_err(|_| bad())?;
        let month: u8 = m.parse().map_err(|_| bad())?;
        let day: u8 = d.parse().map_err(|_| bad())?;
        let leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
        let days = match month {
            4 | 6 | 9 | 11 => 30,
            2 if leap => 29,
            2 => 28,
            1..=12 => 31,
            _ => return Err(bad()),
        };
        if day == 0 || day > days {
            return Err(bad());
        }
        Ok(Date { year, month, day })
    }

    /// A number that grows with the date: year * 10000 + month * 100 + day.
    pub fn ordinal(self) -> i64 {
        i64::from(self.year) * 10000 + i64::from(self.month) * 100 + i64::from(self.day)
    }
}

impl std::fmt::Display for Date {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:04}-{:02}-{:02}", self.year, self.month, self.day)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_days_that_exist() {
        assert_eq!(Date::parse("2004-02-29").unwrap().to_string(), "2004-02-29");
        for bad in
            ["2003-02-29", "2004-13-01", "2004-1-1", "yesterday", "2004-00-10", "2004-01-32", "2004-01-01-01"]
        {
            assert!(Date::parse(bad).is_err(), "{bad}");
        }
    }
}
