//! What a drive's own error codes mean, as data.

use alloc::borrow::Cow;
use alloc::collections::BTreeMap;
use alloc::format;

use super::emergency::Emergency;
use crate::ds402::describe_error_code;

/// What the error codes of a drive mean by its own documents, beyond those of CiA 402.
///
/// ```
/// use servocrab::coe::{Emergency, ErrorTexts};
///
/// let mut texts = ErrorTexts::default();
/// texts.codes.insert(0xFF01, "brake resistor missing".into());
/// let emergency = |code| Emergency { code, register: 0x81, data: [0; 5] };
/// assert_eq!(texts.text(&emergency(0xFF01)), "brake resistor missing");
/// assert_eq!(texts.text(&emergency(0x8611)), "following error");
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ErrorTexts {
    /// Texts of error codes (603Fh), which go before those of CiA 402.
    pub codes: BTreeMap<u16, Cow<'static, str>>,
    /// The number by which the drive itself names its errors, where its emergencies carry one.
    pub number: Option<DriveNumber>,
}

/// A number of the maker's in the five data bytes of an emergency: what the drive shows on its display.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DriveNumber {
    /// The error code with which it comes.
    pub with_code: u16,
    /// Where its two bytes, the low one first, begin among the five (0 to 3).
    pub byte: u8,
    /// What the maker calls it; the number follows in three hexadecimal digits.
    pub prefix: Cow<'static, str>,
    /// Texts of these numbers.
    pub texts: BTreeMap<u16, Cow<'static, str>>,
}

impl ErrorTexts {
    /// What this emergency means: by the drive's own table, else by the table of CiA 402, else by the group of its code.
    #[must_use]
    pub fn text(&self, emergency: &Emergency) -> Cow<'static, str> {
        let of_code = self.codes.get(&emergency.code).cloned();
        of_code
            .or_else(|| self.number.as_ref()?.text(emergency))
            .unwrap_or(Cow::Borrowed(describe_error_code(emergency.code)))
    }
}

impl DriveNumber {
    fn text(&self, emergency: &Emergency) -> Option<Cow<'static, str>> {
        let &[low, high] = emergency
            .data
            .get(usize::from(self.byte)..)?
            .first_chunk()?;
        if emergency.code != self.with_code {
            return None;
        }
        let (prefix, number) = (&self.prefix, u16::from_le_bytes([low, high]));
        Some(Cow::Owned(match self.texts.get(&number) {
            Some(text) => format!("{prefix}{number:03X}: {text}"),
            None => format!("{prefix}{number:03X}"),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn emergency(code: u16, data: [u8; 5]) -> Emergency {
        Emergency {
            code,
            register: 0x81,
            data,
        }
    }

    #[test]
    fn the_drives_own_text_goes_before_the_standards() {
        let mut texts = ErrorTexts::default();
        assert_eq!(
            texts.text(&emergency(0x3220, [0; 5])),
            "DC link under-voltage"
        );
        texts.codes.insert(0x3220, "F502".into());
        assert_eq!(texts.text(&emergency(0x3220, [0; 5])), "F502");
        assert_eq!(texts.text(&emergency(0x3299, [0; 5])), "DC link voltage");
    }

    #[test]
    fn a_number_in_the_data_is_read_where_it_lies_and_with_its_code_alone() {
        let number = |byte| ErrorTexts {
            codes: BTreeMap::new(),
            number: Some(DriveNumber {
                with_code: 0xFF00,
                byte,
                prefix: "alarm A.".into(),
                texts: [(0x0D00, "position deviation".into())].into(),
            }),
        };
        let data = [0xAA, 0x00, 0x0D, 0x10, 0x0C];
        let text = |byte, code| number(byte).text(&emergency(code, data));
        assert_eq!(text(1, 0xFF00), "alarm A.D00: position deviation");
        assert_eq!(text(3, 0xFF00), "alarm A.C10");
        assert_eq!(text(4, 0xFF00), "manufacturer specific");
        assert_eq!(text(1, 0x8611), "following error");
    }
}
