//! What a drive has otherwise than its ESI file says.

use std::fmt;

use super::device::EsiEntry;
use super::device::{EsiDevice, EsiPdo};
use crate::coe::value::column_width;
use crate::coe::{AbortCode, DriveError, Object, ObjectAddress, ReadOnly, SdoError, SdoHandle};
use crate::pdo_map::Entry;

impl EsiDevice {
    /// Reads of a drive what the file says of it, and gives what differs; an empty table where nothing does. The drive is not changed.
    ///
    /// The comparison covers vendor, product and revision (1018h), every PDO of the file, and every readable entry of the
    /// dictionary. A free PDO only has to exist, since its content is whatever was written last. An entry has to exist in the
    /// length of the file (texts may be shorter).
    ///
    /// # Errors
    /// [`DriveError`] if the drive does not answer; a refusal is no error but a difference.
    pub async fn compare(&self, sdo: &SdoHandle) -> Result<EsiDifferences, DriveError> {
        let mut differences = EsiDifferences(Vec::new());
        for (subindex, what, expected) in [
            (1, "vendor", self.vendor),
            (2, "product code", self.product),
            (3, "revision", self.revision),
        ] {
            let object = ObjectAddress::new(0x1018, subindex);
            let held = read(sdo, object).await?;
            let got = held.map_or_else(refusal, |bytes| hexadecimal(&bytes));
            differences.note(object, what, format!("{expected:08X}h"), got);
        }
        for pdo in &self.pdos {
            self.compare_pdo(pdo, sdo, &mut differences).await?;
        }
        for entry in self.dictionary.iter().filter(|entry| entry.readable) {
            compare_entry(entry, sdo, &mut differences).await?;
        }
        Ok(differences)
    }

    async fn compare_pdo(
        &self,
        pdo: &EsiPdo,
        sdo: &SdoHandle,
        differences: &mut EsiDifferences,
    ) -> Result<(), DriveError> {
        let index = pdo.pdo.index;
        let count = ObjectAddress::new(index, 0);
        let entries = match read(sdo, count).await? {
            Ok(bytes) => bytes.first().copied().unwrap_or(0),
            Err(code) => {
                differences.note(count, "PDO", pdo.name.clone(), refusal(code));
                return Ok(());
            }
        };
        if !self.is_fixed(pdo) {
            return Ok(());
        }
        let expected = &pdo.pdo.entries;
        let declared = u8::try_from(expected.len()).unwrap_or(u8::MAX);
        let mut declared_entries = expected.iter();
        for subindex in 1..=entries.max(declared) {
            let object = ObjectAddress::new(index, subindex);
            let declared = declared_entries.next().map(ToString::to_string);
            let got = if subindex > entries {
                "nothing".to_owned()
            } else {
                let object: Object<u32, ReadOnly> = Object::new(index, subindex, "entry");
                match sdo.read(object).await {
                    Ok(raw) => Entry::from_raw(raw).to_string(),
                    Err(error) => refusal(aborted(error)?),
                }
            };
            let declared = declared.unwrap_or_else(|| "nothing".to_owned());
            differences.note(object, "PDO entry", declared, got);
        }
        Ok(())
    }
}

async fn compare_entry(
    entry: &EsiEntry,
    sdo: &SdoHandle,
    differences: &mut EsiDifferences,
) -> Result<(), DriveError> {
    let expected = format!("{} bits", entry.bits);
    match read(sdo, entry.object).await? {
        Err(code) if code.is_no_object() => {
            differences.note(entry.object, &entry.name, expected, "missing".to_owned());
        }
        // It is there, but cannot be read now.
        Err(_) => {}
        Ok(bytes) => {
            let got = u32::try_from(bytes.len())
                .unwrap_or(u32::MAX)
                .saturating_mul(8);
            let is_same = if entry.varies {
                got <= entry.bits
            } else {
                got == entry.bits.next_multiple_of(8)
            };
            if !is_same {
                differences.note(entry.object, &entry.name, expected, format!("{got} bits"));
            }
        }
    }
    Ok(())
}

/// The bytes of an object, or why the drive refuses them.
async fn read(
    sdo: &SdoHandle,
    object: ObjectAddress,
) -> Result<Result<Vec<u8>, AbortCode>, DriveError> {
    match sdo.read_bytes(object.index, object.subindex).await {
        Ok(bytes) => Ok(Ok(bytes)),
        Err(error) => aborted(error).map(Err),
    }
}

/// The code of an abort; any other error goes on.
fn aborted(error: DriveError) -> Result<AbortCode, DriveError> {
    match &error.error {
        SdoError::Aborted { code, .. } => Ok(*code),
        _ => Err(error),
    }
}

fn refusal(code: AbortCode) -> String {
    match code {
        code if code.is_no_object() => "missing".to_owned(),
        code => format!("refused: {code}"),
    }
}

/// A number of a drive as it is written, whatever its length.
fn hexadecimal(bytes: &[u8]) -> String {
    let digits: String = bytes
        .iter()
        .rev()
        .map(|byte| format!("{byte:02X}"))
        .collect();
    format!("{digits}h")
}

/// Everything in which a drive differs from its ESI file; shown as a table.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct EsiDifferences(pub Vec<EsiDifference>);

/// One difference between a drive and its ESI file.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct EsiDifference {
    /// The object.
    pub object: ObjectAddress,
    /// What it is.
    pub what: String,
    /// What the file says.
    pub file: String,
    /// What the drive says.
    pub drive: String,
}

impl EsiDifferences {
    /// Whether the drive is as the file says.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Adds a difference, if it is one.
    fn note(&mut self, object: ObjectAddress, what: &str, file: String, drive: String) {
        if file != drive {
            self.0.push(EsiDifference {
                object,
                what: what.to_owned(),
                file,
                drive,
            });
        }
    }
}

impl fmt::Display for EsiDifferences {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_empty() {
            return f.write_str("the drive is as its ESI file says");
        }
        let head = ["object", "what", "ESI file", "drive"].map(str::to_owned);
        let rows: Vec<[String; 4]> = std::iter::once(head)
            .chain(self.0.iter().map(|difference| {
                [
                    difference.object.to_string(),
                    difference.what.clone(),
                    difference.file.clone(),
                    difference.drive.clone(),
                ]
            }))
            .collect();
        let width = |column: usize| column_width(rows.iter().filter_map(|row| row.get(column)));
        let (object, what, file) = (width(0), width(1), width(2));
        f.write_str("the drive is not as its ESI file says:")?;
        for [of, is, says, drive] in &rows {
            write!(f, "\n  {of:object$}  {is:what$}  {says:file$}  {drive}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file may have a name of megabytes, and formatting takes no width of more than 16 bits.
    #[test]
    fn a_difference_in_an_entry_with_a_long_name_is_shown_and_no_panic() {
        let mut differences = EsiDifferences(Vec::new());
        let name = "x".repeat(70_000);
        let object = ObjectAddress::new(0x2345, 0);
        differences.note(object, &name, "there".into(), "missing".into());
        assert!(differences.to_string().contains(&name));
    }
}
