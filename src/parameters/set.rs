//! The parameters of a drive as data: read from it, and compared with it.

use std::fmt;

use super::value::{ObjectValue, ValueType, known_name};
use crate::coe::information::ObjectCode;
use crate::coe::value::column_width;
use crate::coe::{
    AbortCode, AxisOffset, DriveError, ObjectAddress, SdoError, SdoHandle, TypeCode,
    information::ObjectDictionary, obj,
};
use crate::sii::Identity;

/// An object of which a backup is made.
///
/// ```
/// use servocrab::parameters::ParameterObject;
/// // What the library knows of a drive of two axes; a drive's own objects are added by hand.
/// let mut objects = ParameterObject::known(2);
/// objects.push(ParameterObject::new("2345h:01".parse().unwrap(), "u16".parse().unwrap()));
/// assert!(objects.iter().any(|object| object.name == "position window"));
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ParameterObject {
    /// The object.
    pub object: ObjectAddress,
    /// The type of its value.
    pub kind: ValueType,
    /// Its name; empty if it has none.
    pub name: String,
}

impl ParameterObject {
    /// An object of this type, with the library's name if it has one.
    #[must_use]
    pub fn new(object: ObjectAddress, kind: ValueType) -> Self {
        let name = known_name(object).unwrap_or_default().into();
        Self { object, kind, name }
    }

    /// The parameters of the standard that the library knows, for a drive with this many axes (1 to 8). A drive has some of
    /// them.
    #[must_use]
    pub fn known(axes: u8) -> Vec<Self> {
        let mut all = Vec::new();
        for axis in 1..=axes.clamp(1, 8) {
            let offset = AxisOffset::of_axis(axis);
            for object in obj::all() {
                let address = object.offset(offset).address();
                let again = axis > 1 && address == object.address();
                if !object.readable || !object.writable || again || !is_parameter(address) {
                    continue;
                }
                let kind = TypeCode::from(object.data_type).into();
                let name = object.name.into();
                all.push(Self {
                    object: address,
                    kind,
                    name,
                });
            }
        }
        all
    }
}

/// Whether an object that can be read and written is a parameter. Not so are
///
/// - commands: controlword, mode, targets and offsets of set-points, digital outputs, touch probes, 1010h, 1011h;
/// - records: the error and diagnosis histories, which a write clears;
/// - the PDO mapping and its assignment, which every start writes anew.
///
/// Such objects are in no backup and no restore writes them. The index and the subindex show the commands of CiA 402, of each of eight
/// axes. So the settings of a terminal's channels (8000h, 8010h and on, ETG.5001) are parameters. Of other objects of a
/// terminal those at 80C1h and 80FEh are left out, and those 800h and more further on.
#[must_use]
pub const fn is_parameter(object: ObjectAddress) -> bool {
    match object.index {
        0x1003 | 0x1010 | 0x1011 | 0x10F3 => false,
        // RxPDOs, TxPDOs, and what the sync managers have of them.
        0x1600..=0x17FF | 0x1A00..=0x1BFF | 0x1C10..=0x1C2F => false,
        0x6000..=0x9FFF => match 0x6000 + (object.index - 0x6000) % 0x0800 {
            // Variables of CiA 402. A terminal has records there: the settings of its channels (ETG.5001).
            0x6040 | 0x6042 | 0x6060 | 0x6071 | 0x607A | 0x60B0..=0x60B2 | 0x60B8 | 0x60FF => {
                object.subindex != 0
            }
            0x60C1 | 0x60FE => false,
            _ => true,
        },
        _ => true,
    }
}

/// A parameter with its value.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// The object.
    pub object: ObjectAddress,
    /// Its name; empty if it has none.
    pub name: String,
    /// Its value.
    pub value: ObjectValue,
}

impl Parameter {
    /// Its object, and its name where it has one.
    pub(super) fn title(&self) -> String {
        let Self { object, name, .. } = self;
        match name.as_str() {
            "" => object.to_string(),
            name => format!("{object} {name}"),
        }
    }
}

/// The parameters of one drive, in the order in which they are restored.
///
/// Made by [`ParameterSet::backup`] or read from a file by [`ParameterSet::load`](ParameterSet::load).
///
/// ```no_run
/// # async fn example(sdo: servocrab::coe::SdoHandle) -> Result<(), Box<dyn std::error::Error>> {
/// use servocrab::parameters::{ParameterObject, ParameterSet, Progress};
/// let backup = ParameterSet::backup(&sdo, &ParameterObject::known(2), Progress::none()).await?;
/// backup.set.save("left.toml")?;
/// // … and later:
/// let set = ParameterSet::load("left.toml")?;
/// print!("{}", set.compare(&sdo, Progress::none()).await?);
/// set.restore(&sdo, Progress::none()).await?;
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ParameterSet {
    /// The drive's name, for messages.
    pub drive: Option<String>,
    /// The identity of the drive from which they came. They are restored to drives of the same vendor and product alone.
    pub identity: Option<Identity>,
    /// The parameters.
    pub parameters: Vec<Parameter>,
}

/// What a backup found.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Backup {
    /// The parameters that were read.
    pub set: ParameterSet,
    /// The objects that the drive does not have.
    pub missing: Vec<ObjectAddress>,
    /// The objects that it has, and did not let be read, with its reason.
    pub refused: Vec<(ObjectAddress, AbortCode)>,
}

/// Who gets the progress: the number of objects done, and of all.
pub struct Progress<'a>(Option<&'a mut dyn FnMut(usize, usize)>);

impl<'a> Progress<'a> {
    /// This function gets it.
    pub fn of(tell: &'a mut dyn FnMut(usize, usize)) -> Self {
        Self(Some(tell))
    }

    /// Nobody gets it.
    #[must_use]
    pub const fn none() -> Self {
        Self(None)
    }

    pub(super) fn tell(&mut self, done: usize, of: usize) {
        if let Some(tell) = &mut self.0 {
            tell(done, of);
        }
    }
}

impl fmt::Debug for Progress<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Progress").finish_non_exhaustive()
    }
}

/// A parameter of which a drive holds another value.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// The parameter with the value of the set.
    pub parameter: Parameter,
    /// What the drive holds.
    pub held: Held,
}

/// What a drive says of an object.
#[derive(Debug, Clone, PartialEq)]
pub enum Held {
    /// It holds this value.
    Value(ObjectValue),
    /// It does not let it be read.
    Refused(AbortCode),
}

impl fmt::Display for Held {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Value(value) => value.fmt(f),
            Self::Refused(code) => code.fmt(f),
        }
    }
}

/// The differences between a set and a drive; shown side by side.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Differences(pub Vec<Difference>);

impl fmt::Display for Differences {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rows: Vec<_> = self
            .0
            .iter()
            .map(|difference| {
                let parameter = &difference.parameter;
                let object = parameter.title();
                let held = difference.held.to_string();
                (object, parameter.value.to_string(), held)
            })
            .collect();
        let first = column_width(rows.iter().map(|row| &row.0)).max(6);
        let second = column_width(rows.iter().map(|row| &row.1)).max(4);
        if !rows.is_empty() {
            writeln!(f, "{:first$}  {:second$}  drive", "object", "file")?;
        }
        for (object, value, held) in rows {
            writeln!(f, "{object:first$}  {value:second$}  {held}")?;
        }
        Ok(())
    }
}

impl ParameterSet {
    /// Reads these objects of a drive, in this order. Those that are no parameters ([`is_parameter`]) are left out.
    ///
    /// # Errors
    /// [`DriveError`] if the drive does not answer or breaks the protocol; that it has not an object is none.
    pub async fn backup(
        sdo: &SdoHandle,
        objects: &[ParameterObject],
        mut progress: Progress<'_>,
    ) -> Result<Backup, DriveError> {
        let mut backup = Backup {
            set: Self {
                drive: Some(sdo.drive().name.clone()),
                identity: Some(sdo.drive().identity),
                parameters: Vec::new(),
            },
            missing: Vec::new(),
            refused: Vec::new(),
        };
        for (done, object) in objects.iter().enumerate() {
            progress.tell(done, objects.len());
            let address = object.object;
            if !is_parameter(address) {
                continue;
            }
            match read(sdo, address).await? {
                Ok(bytes) => backup.set.parameters.push(Parameter {
                    object: address,
                    name: object.name.clone(),
                    value: ObjectValue::decode(object.kind, &bytes),
                }),
                Err(code) if code.is_no_object() => backup.missing.push(address),
                Err(code) => backup.refused.push((address, code)),
            }
        }
        progress.tell(objects.len(), objects.len());
        Ok(backup)
    }

    /// Compares the set with a drive.
    ///
    /// # Errors
    /// [`DriveError`] if the drive does not answer or breaks the protocol; that it refuses an object is a difference.
    pub async fn compare(
        &self,
        sdo: &SdoHandle,
        mut progress: Progress<'_>,
    ) -> Result<Differences, DriveError> {
        let mut differences = Vec::new();
        let all = self.parameters.len();
        for (done, parameter) in self.parameters.iter().enumerate() {
            progress.tell(done, all);
            let held = match read(sdo, parameter.object).await? {
                Ok(bytes) if parameter.value.is_held_by(&bytes) => continue,
                Ok(bytes) => Held::Value(ObjectValue::decode(parameter.value.value_type(), &bytes)),
                Err(code) => Held::Refused(code),
            };
            differences.push(Difference {
                parameter: parameter.clone(),
                held,
            });
        }
        progress.tell(all, all);
        Ok(Differences(differences))
    }
}

/// The bytes of an object, or why the drive refuses to show them.
pub(super) async fn read(
    sdo: &SdoHandle,
    object: ObjectAddress,
) -> Result<Result<Vec<u8>, AbortCode>, DriveError> {
    match sdo.read_bytes(object.index, object.subindex).await {
        Ok(bytes) => Ok(Ok(bytes)),
        Err(DriveError {
            error: SdoError::Aborted { code, .. },
            ..
        }) => Ok(Err(code)),
        Err(error) => Err(error),
    }
}

// Which objects of a drive are parameters, as it says itself.

impl ParameterObject {
    /// The parameters of a drive: those entries of its object dictionary that can be read and written. For a drive without
    /// SDO information these are those of the standard that the library [knows](Self::known), for as many axes as have a
    /// statusword.
    ///
    /// # Errors
    /// [`DriveError`] if the drive does not answer or breaks the protocol.
    pub async fn of(sdo: &SdoHandle) -> Result<Vec<Self>, DriveError> {
        match sdo.dictionary().await {
            Ok(dictionary) => Ok(Self::of_dictionary(&dictionary)),
            Err(DriveError {
                error: SdoError::NotSupported { .. },
                ..
            }) => {
                let mut axes = 1;
                while axes < 8 {
                    match sdo.read(obj::STATUSWORD.axis(axes + 1)).await {
                        Ok(_) => axes += 1,
                        Err(DriveError {
                            error: SdoError::Aborted { code, .. },
                            ..
                        }) if code.is_no_object() => break,
                        Err(error) => return Err(error),
                    }
                }
                Ok(Self::known(axes))
            }
            Err(error) => Err(error),
        }
    }

    /// The parameters in a drive's object dictionary.
    #[must_use]
    pub fn of_dictionary(dictionary: &ObjectDictionary) -> Vec<Self> {
        let mut all = Vec::new();
        for object in &dictionary.objects {
            for entry in &object.entries {
                let address = entry.address;
                if !entry.access.readable() || !entry.access.writable() || !is_parameter(address) {
                    continue;
                }
                let name = match (known_name(address), object.description.code) {
                    (Some(known), _) => known.into(),
                    (None, ObjectCode::Array | ObjectCode::Record) => {
                        format!("{}: {}", object.description.name, entry.name)
                    }
                    (None, _) => object.description.name.clone(),
                };
                all.push(Self {
                    object: address,
                    kind: entry.data_type.into(),
                    name,
                });
            }
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_and_records_of_every_axis_are_no_parameters() {
        for index in [
            0x6040, 0x6860, 0x707A, 0x98FF, 0x1010, 0x1600, 0x1A03, 0x1C12, 0x1003,
        ] {
            assert!(!is_parameter(ObjectAddress::new(index, 0)), "{index:04X}h");
        }
        for index in [0x2010, 0x6067, 0x6867, 0x1C32, 0x10F1, 0x607D] {
            assert!(is_parameter(ObjectAddress::new(index, 1)), "{index:04X}h");
        }
    }

    /// ETG.5001: a terminal of eight channels has their settings in 8000h, 8010h … 8070h; those of the fifth begin with 8040h:01.
    #[test]
    fn the_settings_of_all_channels_of_a_terminal_are_parameters() {
        let left_out: Vec<_> = (0..16u16)
            .map(|channel| ObjectAddress::new(0x8000 + 0x10 * channel, 0x11))
            .filter(|object| !is_parameter(*object))
            .map(|object| object.to_string())
            .collect();
        assert!(left_out.is_empty(), "left out without a word: {left_out:?}");
    }

    #[test]
    fn the_known_objects_of_two_axes_are_each_there_once() {
        let known = ParameterObject::known(2);
        let mut addresses: Vec<_> = known.iter().map(|object| object.object).collect();
        let all = addresses.len();
        addresses.sort_unstable();
        addresses.dedup();
        assert_eq!(addresses.len(), all);
        let second = ObjectAddress::new(0x6867, 0);
        assert!(known.iter().any(|object| object.object == second));
    }

    #[test]
    fn a_parameter_without_a_name_is_shown_by_its_object_alone() {
        let named = |name: &str| Parameter {
            object: ObjectAddress::new(0x5FFF, 0),
            name: name.into(),
            value: ObjectValue::U8(0),
        };
        assert_eq!(named("").title(), "5FFFh:00");
        assert_eq!(named("gain").title(), "5FFFh:00 gain");
    }

    #[test]
    fn differences_stand_side_by_side() {
        let difference = |index, name: &str, value: ObjectValue, held| Difference {
            parameter: Parameter {
                object: ObjectAddress::new(index, 0),
                name: name.into(),
                value,
            },
            held,
        };
        let differences = Differences(vec![
            difference(
                0x6067,
                "position window",
                50_u32.into(),
                Held::Value(7_u32.into()),
            ),
            difference(0x2345, "", "ab".into(), Held::Refused(AbortCode::NO_OBJECT)),
        ]);
        assert_eq!(
            differences.to_string(),
            "object                    file      drive\n\
             6067h:00 position window  50 (u32)  7 (u32)\n\
             2345h:00                  \"ab\"      object does not exist (06020000h)\n"
        );
    }

    /// A file may hold texts of a megabyte, and formatting takes no width of more than 16 bits.
    #[test]
    fn differences_of_long_texts_are_shown_and_no_panic() {
        let long = "x".repeat(70_000);
        for (name, value) in [(long.as_str(), "1"), ("short", long.as_str())] {
            let text = format!(
                "[[parameter]]\nobject = \"2345h:00\"\nname = \"{name}\"\ntype = \"string\"\nvalue = \"{value}\"\n"
            );
            let set = ParameterSet::from_toml(&text, "drive.toml").unwrap();
            let parameter = set.parameters.into_iter().next().unwrap();
            let held = Held::Refused(AbortCode::NO_OBJECT);
            let differences = Differences(vec![Difference { parameter, held }]);
            assert!(differences.to_string().contains(&long));
        }
    }
}
