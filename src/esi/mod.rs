//! ESI files: what a maker says of its devices in XML (`EtherCATInfo`, ETG.2000), with the feature `esi`.
//!
//! From an [`EsiDevice`] comes a drive of a network in one call: [`DriveConfig::from_esi`](crate::DriveConfig::from_esi). It consists of a
//! [`DriveDescription`](crate::drives::DriveDescription) ([`EsiDevice::description`]) and a start-up list of its `InitCmd`s
//! ([`EsiDevice::start_up_list`]). [`EsiDevice::compare`] gives
//! a table of what a drive has otherwise.
//!
//! Files are not trusted: at most [`MOST_BYTES`], a bounded number of elements, no document type definition (and so no entities),
//! no recursion. Of the slots of a modular device
//! those are read whose module is the default or has to be there. Reading one takes at most 64 KiB, 128 bytes of memory for each of its bytes, and 1
//! KiB for each entry of its dictionaries. They have at most 262 144 entries.

mod compare;
mod describe;
mod device;
mod xml;

pub use compare::{EsiDifference, EsiDifferences};
pub use describe::{EsiDriveError, NoAxis};
pub use device::{
    EsiClockMode, EsiDevice, EsiEntry, EsiInitCommand, EsiPdo, EsiSlot, EsiSyncManager,
    EsiTransition, InitCommandFault, RefusedInitCommand,
};
pub use xml::{EsiError, EsiFault, MOST_BYTES};

use std::path::Path;

/// An ESI file.
///
/// ```
/// use servocrab::esi::Esi;
/// let text = r##"<EtherCATInfo>
///   <Vendor><Id>#x0000006A</Id><Name>Example</Name></Vendor>
///   <Descriptions><Devices><Device>
///     <Type ProductCode="#x44530402" RevisionNo="1">Drive</Type><Name>Servo drive</Name>
///     <RxPdo Sm="2"><Index>#x1600</Index>
///       <Entry><Index>#x6040</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry>
///       <Entry><Index>#x607A</Index><SubIndex>0</SubIndex><BitLen>32</BitLen></Entry></RxPdo>
///     <TxPdo Sm="3"><Index>#x1A00</Index>
///       <Entry><Index>#x6041</Index><SubIndex>0</SubIndex><BitLen>16</BitLen></Entry>
///       <Entry><Index>#x6064</Index><SubIndex>0</SubIndex><BitLen>32</BitLen></Entry></TxPdo>
///   </Device></Devices></Descriptions>
/// </EtherCATInfo>"##;
/// let esi = Esi::from_bytes("drive.xml", text.as_bytes())?;
/// assert_eq!(esi.devices[0].description()?.product, Some(0x4453_0402));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct Esi {
    /// The maker's number.
    pub vendor: u32,
    /// The maker's name.
    pub vendor_name: String,
    /// The devices, in the file's order.
    pub devices: Vec<EsiDevice>,
}

impl Esi {
    /// Reads a file.
    ///
    /// # Errors
    /// [`EsiError`] with the file, and line and element where they apply: it cannot be read, is too large, is no XML, or is no ESI
    /// file.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, EsiError> {
        let path = path.as_ref();
        let name = path.display().to_string();
        let bytes = xml::read(path).map_err(|fault| EsiError::of_file(&name, fault))?;
        Self::from_bytes(&name, &bytes)
    }

    /// Reads the content of a file; `name` is for messages. UTF-8, or ISO 8859-1 where the file says so.
    ///
    /// # Errors
    /// As [`Esi::load`], but for what concerns the reading of the file.
    pub fn from_bytes(name: &str, bytes: &[u8]) -> Result<Self, EsiError> {
        let text = xml::decode(bytes).map_err(|fault| EsiError::of_file(name, fault))?;
        let document = xml::parse(name, &text)?;
        let root = xml::Element::root(name, &document);
        if root.name() != "EtherCATInfo" {
            return Err(root.error(EsiFault::NoEsi));
        }
        let vendor = root.need("Vendor")?;
        let modules = device::Modules::read(&root)?;
        let mut devices = Vec::new();
        let mut room = device::MOST_ENTRIES;
        for devices_of_file in root
            .children("Descriptions")
            .flat_map(|descriptions| descriptions.children("Devices"))
        {
            for device in devices_of_file.children("Device") {
                devices.push(EsiDevice::read(
                    vendor.need("Id")?.number()?,
                    &device,
                    &modules,
                    &mut room,
                )?);
            }
        }
        Ok(Self {
            vendor: vendor.need("Id")?.number()?,
            vendor_name: vendor.text_of("Name"),
            devices,
        })
    }

    /// The device with this product code, of the highest revision not above `revision`, or else the lowest above.
    #[must_use]
    pub fn device(&self, product: u32, revision: u32) -> Option<&EsiDevice> {
        let same = || {
            self.devices
                .iter()
                .filter(|device| device.product == product)
        };
        let not_above = same().filter(|device| device.revision <= revision);
        not_above
            .max_by_key(|device| device.revision)
            .or_else(|| same().min_by_key(|device| device.revision))
    }
}

#[cfg(test)]
mod tests;
