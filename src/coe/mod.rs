//! CANopen over EtherCAT: typed objects, the SDO codec, the mailbox client, emergencies.
