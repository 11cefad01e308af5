//! The EEPROM of a device on a scanned line: read, written as a whole image, and in force.

use super::Line;
use crate::{
    bus::{
        error::{AlError, EepromError},
        line,
        requests::{Context, eeprom::WholeEeprom},
    },
    coe::{DriveError, DriveId},
    ds402::State,
    parameters::{Enabled, Guard, GuardFault},
    sii::{Identity, SiiImage, SiiImageError},
};

/// What an EEPROM of a [`Line`] holds: read by [`Line::read_eeprom`], and needed to write it. Keep it before that: with it what was there can
/// be restored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EepromContent {
    position: u16,
    bytes: Vec<u8>,
}

impl EepromContent {
    /// The position of its device in the line, from 0.
    #[must_use]
    pub const fn position(&self) -> u16 {
        self.position
    }

    /// All bytes, valid or not.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The image that they are.
    ///
    /// # Errors
    /// [`SiiImageError`] after a write that was interrupted, for one: then nobody can say by it which device this is.
    pub fn image(&self) -> Result<SiiImage, SiiImageError> {
        SiiImage::new(self.bytes.as_slice())
    }
}

/// Which images are written to an EEPROM that holds a valid one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageKind {
    /// Those of its own vendor and product.
    Same,
    /// Any.
    Any,
}

/// What came of [`Line::write_eeprom`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub struct EepromWritten {
    /// How many words were written, each read back; 0 if the image was there.
    pub words: usize,
    /// The configured station alias that the device has now (0012h). The image's, if the device has taken it over when its EEPROM was loaded
    /// again; otherwise that counts from the next power-up, as do the rest of words 0 to 6 and the identity.
    pub alias: u16,
}

impl Line {
    /// Reads the EEPROM of the device at this position, also of one that has a [`problem`](crate::bus::LineDevice::problem): as many bytes as
    /// it says that it has.
    ///
    /// # Errors
    /// [`EepromAccessError::NoDevice`], [`Read`](EepromAccessError::Read), [`Ended`](EepromAccessError::Ended).
    pub async fn read_eeprom(&self, position: u16) -> Result<EepromContent, EepromAccessError> {
        let count = self.devices().len();
        if usize::from(position) >= count {
            return Err(EepromAccessError::NoDevice { position, count });
        }
        let read = async move |context: Context| {
            let eeprom = WholeEeprom::at(&context.registers, position).await?;
            eeprom.read().await
        };
        let read = self.on_bus(read).await.ok_or(EepromAccessError::Ended)?;
        let bytes = read.map_err(|error| EepromAccessError::Read { position, error })?;
        Ok(EepromContent { position, bytes })
    }

    /// Writes an image where `before` was read, in INIT: the words that differ, each read back. Then the device loads words 0 to 6 again, if
    /// it can. That ends the line: what it says of this device is over.
    ///
    /// From the first word to the last one the checksum is wrong, and a device that is switched on then is in INIT and answers by its registers
    /// alone. A write that was interrupted, or whose future was dropped, can be repeated with this image, or with that of `before`.
    ///
    /// ```no_run
    /// # async fn example() -> Result<(), Box<dyn std::error::Error>> {
    /// use servocrab::{Network, bus::ImageKind};
    /// let line = Network::builder().interface("eth0").scan().await?;
    /// let before = line.read_eeprom(2).await?;
    /// std::fs::write("old.bin", before.bytes())?;
    /// let image = before.image()?.with_alias(7);
    /// let written = line.write_eeprom(&before, &image, ImageKind::Same).await?;
    /// if written.alias != 7 {
    ///     println!("switch the device off and on");
    /// }
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// Nothing was written after [`EepromAccessError::Enabled`], [`Unasked`](EepromAccessError::Unasked),
    /// [`OtherKind`](EepromAccessError::OtherKind), [`TooLong`](EepromAccessError::TooLong), [`Read`](EepromAccessError::Read),
    /// [`OtherContent`](EepromAccessError::OtherContent) and [`NotInInit`](EepromAccessError::NotInInit).
    /// A part may have been after [`Write`](EepromAccessError::Write), and all was after [`Reload`](EepromAccessError::Reload).
    pub async fn write_eeprom(
        self,
        before: &EepromContent,
        image: &SiiImage,
        kind: ImageKind,
    ) -> Result<EepromWritten, EepromAccessError> {
        let written = self.write(before, image, kind).await;
        self.close().await;
        written
    }

    async fn write(
        &self,
        before: &EepromContent,
        image: &SiiImage,
        kind: ImageKind,
    ) -> Result<EepromWritten, EepromAccessError> {
        let position = before.position;
        if let Ok(own) = before.image() {
            may_replace(position, &own, image, kind)?;
        }
        self.refuse_enabled().await?;
        let (before, image) = (before.bytes.clone(), image.clone());
        let write = async move |context: Context| {
            let registers = &context.registers;
            let eeprom = WholeEeprom::at(registers, position)
                .await
                .map_err(|error| EepromAccessError::Read { position, error })?;
            let holds = eeprom.read().await;
            if holds.map_err(|error| EepromAccessError::Read { position, error })? != before {
                return Err(EepromAccessError::OtherContent { position });
            }
            line::set_back(registers, eeprom.station)
                .await
                .map_err(|error| EepromAccessError::NotInInit { position, error })?;
            let words = eeprom
                .write(&before, &image)
                .await
                .map_err(|error| EepromAccessError::Write { position, error })?;
            let alias = eeprom
                .reload()
                .await
                .map_err(|error| EepromAccessError::Reload { position, error })?;
            Ok(EepromWritten { words, alias })
        };
        let written = self.on_bus(write).await;
        written.unwrap_or(Err(EepromAccessError::Ended))
    }

    /// By the statuswords of all drives that are in PREOP. The others have been set back to INIT.
    async fn refuse_enabled(&self) -> Result<(), EepromAccessError> {
        for sdo in self
            .devices()
            .iter()
            .filter_map(|device| device.sdo.as_ref())
        {
            Guard::of(sdo).await.map_err(|fault| {
                let drive = sdo.drive().clone();
                match fault {
                    GuardFault::Enabled(Enabled { axis, state }) => {
                        EepromAccessError::Enabled { drive, axis, state }
                    }
                    GuardFault::Sdo(error) => DriveError { drive, error }.into(),
                }
            })?;
        }
        Ok(())
    }
}

fn may_replace(
    position: u16,
    own: &SiiImage,
    image: &SiiImage,
    kind: ImageKind,
) -> Result<(), EepromAccessError> {
    let (expected, got) = (own.identity(), image.identity());
    if kind == ImageKind::Same && (expected.vendor, expected.product) != (got.vendor, got.product) {
        return Err(EepromAccessError::OtherKind {
            position,
            expected,
            got,
        });
    }
    let bytes = image.bytes().len();
    match SiiImage::room(own.bytes()) {
        Some(room) if bytes > room => Err(EepromAccessError::TooLong {
            position,
            room,
            bytes,
        }),
        _ => Ok(()),
    }
}

/// Why an EEPROM could not be read or written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EepromAccessError {
    /// The line has no such position.
    #[error("there is nothing at position {position}: the line has {count} devices")]
    NoDevice {
        /// The position, from 0.
        position: u16,
        /// How many devices there are.
        count: usize,
    },
    /// An axis of the line has power.
    #[error(
        "{drive:#}: axis {axis} is in {state}: no EEPROM is written while an axis of the line is enabled. Disable it first"
    )]
    Enabled {
        /// The drive.
        drive: DriveId,
        /// Its axis, from 1.
        axis: u8,
        /// The state that it shows.
        state: State,
    },
    /// Whether an axis is enabled could not be read.
    #[error(
        "no EEPROM is written while it is not known that all axes of the line are disabled: {0}"
    )]
    Unasked(#[from] DriveError),
    /// The image is of another vendor or product.
    #[error("the image is of {got}, and the device at position {position} is of {expected}")]
    OtherKind {
        /// The position.
        position: u16,
        /// What its EEPROM says.
        expected: Identity,
        /// What the image says.
        got: Identity,
    },
    /// The image is longer than the EEPROM.
    #[error(
        "the image has {bytes} bytes, and the EEPROM of the device at position {position} has {room}"
    )]
    TooLong {
        /// The position.
        position: u16,
        /// The bytes of the EEPROM.
        room: usize,
        /// The bytes of the image.
        bytes: usize,
    },
    /// The EEPROM holds something else than was read before.
    #[error(
        "the EEPROM of the device at position {position} holds something else than was read before: read it again"
    )]
    OtherContent {
        /// The position.
        position: u16,
    },
    /// The device is not in INIT.
    #[error("the EEPROM of the device at position {position} is written in INIT alone: {error}")]
    NotInInit {
        /// The position.
        position: u16,
        /// Why not.
        error: AlError,
    },
    /// It could not be read.
    #[error("reading the EEPROM of the device at position {position}: {error}")]
    Read {
        /// The position.
        position: u16,
        /// Why not.
        error: EepromError,
    },
    /// Writing has failed, and nothing, or a part of the image, is there.
    #[error(
        "writing the EEPROM of the device at position {position}: {error}. It has no valid image until one is written whole: write the one \
         that was there before, or this one again"
    )]
    Write {
        /// The position.
        position: u16,
        /// Why.
        error: EepromError,
    },
    /// All is written and read back, and the device has not loaded it.
    #[error(
        "the EEPROM of the device at position {position} is written, but not in force: {error}. Switch the device off and on"
    )]
    Reload {
        /// The position.
        position: u16,
        /// Why not.
        error: EepromError,
    },
    /// The bus thread has ended.
    #[error("the bus thread has ended")]
    Ended,
}
