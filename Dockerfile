# Environments, planner and benchmark on a processor:
#   docker build -t smp-gym .
#   docker run --rm -v "$PWD/results:/results" smp-gym \
#     run --tasks Placement --methods smp,promp --episodes 20 --out /results/first
FROM python:3.11-slim
WORKDIR /src
COPY pyproject.toml constraints.txt README.md LICENSE ./
COPY envs_assets envs_assets
COPY smp_gym smp_gym
COPY smp_planner smp_planner
# torch first, from the index of its builds for processors, which are much smaller.
RUN pip install --no-cache-dir -c constraints.txt \
      --extra-index-url https://download.pytorch.org/whl/cpu torch \
 && pip install --no-cache-dir -c constraints.txt '.[all]'
WORKDIR /results
ENTRYPOINT ["smp-bench"]
CMD ["list"]
