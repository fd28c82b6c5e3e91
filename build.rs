//! Generates the wire types, their proto3 JSON and the service of gRPC from `proto/`, without `protoc`, and the list of the
//! viewer's files from `viewer/prebuilt`. Does nothing for the core alone.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    #[cfg(feature = "server")]
    {
        wire::generate()?;
        viewer::generate()?;
    }
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

#[cfg(feature = "server")]
mod viewer {
    use std::fmt::Write;
    use std::hash::{DefaultHasher, Hash, Hasher};
    use std::path::{Path, PathBuf};
    use std::{env, fs};

    /// The bundle that `scripts/build-viewer` made; it is in the repository (docs/adr/0008-viewer.md).
    const BUNDLE: &str = "viewer/prebuilt";

    /// `off` builds a server without the viewer.
    const SWITCH: &str = "UBBMAP_VIEWER";

    pub fn generate() -> Result<(), Box<dyn std::error::Error>> {
        println!("cargo:rerun-if-env-changed={SWITCH}");
        // Where it is not there, cargo looks again at each build.
        println!("cargo:rerun-if-changed={BUNDLE}");
        let bundle = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?).join(BUNDLE);
        let off = env::var(SWITCH).is_ok_and(|value| value == "off");
        let mut files = Vec::new();
        if off {
            // The page says so itself.
        } else if bundle.is_dir() {
            list(&bundle, &mut files)?;
        } else {
            println!("cargo:warning={BUNDLE} is not there: the server is built without the viewer");
        }
        files.sort();
        let mut code = String::from("&[\n");
        for file in files {
            let name = file.strip_prefix(&bundle)?.to_str().ok_or("a file name is not Unicode")?.replace('\\', "/");
            let mut hasher = DefaultHasher::new();
            fs::read(&file)?.hash(&mut hasher);
            let tag = format!("\"{:016x}\"", hasher.finish());
            writeln!(code, "    Asset {{ name: {name:?}, tag: {tag:?}, bytes: include_bytes!({file:?}) }},")?;
        }
        code.push(']');
        fs::write(PathBuf::from(env::var("OUT_DIR")?).join("viewer.rs"), code)?;
        Ok(())
    }

    fn list(folder: &Path, files: &mut Vec<PathBuf>) -> std::io::Result<()> {
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            if path.is_dir() {
                list(&path, files)?;
            } else {
                files.push(path);
            }
        }
        Ok(())
    }
}
