# docker build -t msal-cli .   compiles the kernels of this checkout
# docker build -t msal-cli --build-arg SOURCE=dist/msal_cli-....whl .    takes a wheel for Linux
# docker run --rm --user "$(id -u):$(id -g)" -v "$PWD:/data" msal-cli denoise scans -o out
FROM python:3.12-slim AS build
ARG SOURCE=.
WORKDIR /source
COPY . .
# Without a C compiler the build links with zig, which pip brings into the build's own environment.
RUN python -m venv --without-pip /opt/msal \
    && pip --python /opt/msal install --no-cache-dir "./$SOURCE" \
    && find /opt/msal -type d -name tests -prune -exec rm -r {} +

FROM python:3.12-slim
COPY --from=build /opt/msal /opt/msal
ENV PATH=/opt/msal/bin:$PATH HOME=/tmp
WORKDIR /data
USER 1000:1000
ENTRYPOINT ["msal"]
CMD ["--help"]
