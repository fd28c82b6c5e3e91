//! Generates the wire types, their proto3 JSON and the service of gRPC from `proto/`, without `protoc`. Does nothing for the core alone.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    #[cfg(feature = "server")]
    wire::generate()?;
    Ok(())
}

#[cfg(feature = "server")]
mod wire {
    use prost::Message;
    use std::path::PathBuf;
    use std::{env, fs};

    /// The package of the interface.
    const PACKAGE: &str = ".ubbmap.v1";

    /// How the generator of the JSON code reads numbers: through a buffer, and with an error that does not say what
    /// was expected. Ours reads them directly.
    const THEIR_NUMBER: &str = "::pbjson::private::NumberDeserialize";

    pub fn generate() -> Result<(), Box<dyn std::error::Error>> {
        println!("cargo:rerun-if-changed=proto");
        let mut files: Vec<PathBuf> =
            fs::read_dir("proto/ubbmap/v1")?.map(|entry| entry.map(|entry| entry.path())).collect::<Result<_, _>>()?;
        files.retain(|path| path.extension().is_some_and(|extension| extension == "proto"));
        files.sort();
        let descriptors = protox::compile(&files, ["proto"])?;

        let folder = PathBuf::from(env::var("OUT_DIR")?);
        fs::write(folder.join("ubbmap.v1.bin"), descriptors.encode_to_vec())?;
        prost_build::Config::new().btree_map(["."]).compile_fds(descriptors.clone())?;

        // The service alone, in a file of its own: messages know no transport.
        let service = folder.join("grpc");
        fs::create_dir_all(&service)?;
        tonic_prost_build::configure()
            .extern_path(PACKAGE, "crate::wire::v1")
            .codec_path("crate::transport::grpc::codec::Codec")
            .out_dir(service)
            .compile_fds(descriptors.clone())?;

        let mut json = pbjson_build::Builder::new();
        for file in descriptors.file {
            json.register_file_descriptor(file);
        }
        json.preserve_proto_field_names().emit_fields().btree_map(["."]).build(&[PACKAGE])?;

        let generated = folder.join("ubbmap.v1.serde.rs");
        let code = fs::read_to_string(&generated)?;
        if !code.contains(THEIR_NUMBER) {
            return Err(format!("{THEIR_NUMBER} is not in the generated JSON code").into());
        }
        fs::write(&generated, code.replace(THEIR_NUMBER, "crate::wire::JsonNumber"))?;
        Ok(())
    }
}
